"""Where displayed frames go: files, scores, reports, the console and the live page."""
