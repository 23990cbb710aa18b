"""A CANopen node by itself: the services of CiA 301 and the LSS slave of CiA 305, over any object dictionary."""
