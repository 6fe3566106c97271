"""Training pairs made by the program itself: what a restorer sees, and what it should have shown.

A scene is encoded as for streaming (:mod:`.ladder`); views come from walks and the server's own predictor
(:mod:`.views`); references are rendered, coded as H.264 and aligned as in the stream (:mod:`.maker`); crops of the
result are kept as bytes (:mod:`.crops`).
"""
