"""The loops that are learned on: designed here, or closed by a controller that is not ours."""
