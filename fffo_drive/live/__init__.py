"""Live view of a running axis: rows decimated on a thread of their own, a scope page, and a WebSocket for viewers."""
