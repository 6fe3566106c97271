"""Trains the predictors, the field-of-view model and the restoration networks."""
