"""Pictures, videos and a player of one highway.

- `env.render`, `medjax.render.frame`: one state as an RGB array (Pillow).
- `medjax.render.video`: a recording as .mp4, .gif or .png (Pillow, and ffmpeg as imageio-ffmpeg brings it).
- `medjax.render.player`: a recording, or two side by side, as one HTML file that needs nothing else.
- `python -m medjax.render`: all three from a shell.

Nothing here is imported by `import medjax`, and Pillow only where it is needed.
"""
