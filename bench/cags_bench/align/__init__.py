"""Time and quality of alignment and closed-form restoration, by LoD and by error of the predicted pose."""
