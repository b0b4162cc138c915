"""The commands, one small module a group; imported by nothing."""
