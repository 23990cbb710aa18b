"""CAN frames and links, on AF_CAN or on a loopback bus."""
