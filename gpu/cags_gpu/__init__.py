"""The graphics processor: one set of WGSL shaders for client, server and browser, run here through ``wgpu``.

``graph.json`` and ``wgsl/`` are the frame; the modules beside them are one host of it (the viewer in the browser is
another). docs/gpu.md explains both.
"""
