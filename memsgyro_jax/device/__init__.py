"""The mass on its springs: parameters, equations of motion, and their exact propagation over a sample."""
