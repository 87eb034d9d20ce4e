"""How far a linear loop is from instability: loops at poses, structured singular values, margins."""
