"""Value types and codecs that every part shares."""
