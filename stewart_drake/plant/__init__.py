"""The simulated mechanism: Drake's MultibodyPlant from a generated SDF, closed form, MuJoCo on MJCF, or a user's."""
