"""What is on the wire: messages, their fields, their strict encoding and its limits."""
