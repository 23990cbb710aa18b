"""Laws as pure steps: PI, friction observer, their sum, the reference, and the envelope that knows none of them."""
