"""Everything before takeoff: preflight, parameters, what the team does when the ground station is gone."""
