"""What runs on the computer beside the robot: estimators, controllers and tuners, each with options, law and part."""
