"""Published laws that the controller is compared with: friction and disturbance observers."""
