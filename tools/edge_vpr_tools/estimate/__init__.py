"""What a design needs before it is built: exact counts, instructions by tables, modelled energy."""
