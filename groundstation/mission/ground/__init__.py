"""Everything before the team flies by our setpoints: preflight, parameters, arming, taking over who is in the air."""
