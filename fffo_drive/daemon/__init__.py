"""The daemon: one axis, kept connected, supervised, recorded, and controlled over a Unix socket."""
