"""Records of flights: logs, their manifests, what can be read out of them, and imports of others' logs."""
