"""``cags-bench predict``: accuracy of pose prediction, and the width of references that it requires."""
