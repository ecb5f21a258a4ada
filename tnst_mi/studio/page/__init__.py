"""Who asks the studio for what, over HTTP: `server` and `routes` first."""
