"""The studio in the browser: `server` answers the page that `access` lets in, by the `routes` of a `session`."""
