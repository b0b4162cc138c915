"""What is cleaned every night: maps that are new or changed, one after the other, unattended."""
