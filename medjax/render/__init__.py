"""Pictures, videos and an HTML player of one highway.

- `env.render`, `medjax.render.frame`: one state as an RGB array (Pillow).
- `medjax.render.video`: a recording as .mp4, .gif or .png (Pillow, and the ffmpeg of imageio-ffmpeg).
- `medjax.render.player`: one recording, or two side by side, as a self-contained HTML file.
- `python -m medjax.render`: all three from a shell.

`import medjax` imports nothing from here, and Pillow is imported only where it is needed.
"""
