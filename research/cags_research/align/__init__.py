"""Aligners to compare with: the readable definition (``oracle``), and two that leave out depth.

``unaligned`` shows the reference where it was drawn; ``rotation`` turns it, as plain remote rendering does.
"""
