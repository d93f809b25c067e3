"""Terms of the balances, a file each; ``registry`` has them all."""
