"""Live view of a running axis: rows decimated on a thread of their own, and a scope page over HTTP and WebSocket."""
