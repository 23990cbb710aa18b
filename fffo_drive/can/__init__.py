"""CAN frames and links: the wire below the drive, whether it is AF_CAN or a loopback bus."""
