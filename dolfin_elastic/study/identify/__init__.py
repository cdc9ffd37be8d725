"""Constants of a whole case from measured curves and displacement fields."""
