"""The robot as Drake's MultibodyPlant, from a generated SDF."""
