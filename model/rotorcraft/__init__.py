"""One axis of a multirotor: motors with a lag, a thrust curve, torque, drag; and what noise does to it."""
