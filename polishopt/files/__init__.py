"""Files: the only floor that knows YAML, topography files, NC programs and results.

Nothing is imported here, so that `polishopt.files.config` answers before JAX is loaded.
"""
