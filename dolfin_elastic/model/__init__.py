"""What is simulated: kinematics, laws, supports and loads, in UFL only."""
