"""Motion apart from looks: where the splats of a tile are, how they turn, fade and end, span by span."""
