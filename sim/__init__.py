"""Stand-ins for hardware: the MuJoCo robot and whatever else a cell needs to run without an arm."""
