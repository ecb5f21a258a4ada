"""Files of cameras: `reading` chooses by extension; `tables` are our own TOML and JSON, `usd` are stages of USD.

All of them give `scene_camera.SceneCamera`s, one for each frame or one for all.
"""
