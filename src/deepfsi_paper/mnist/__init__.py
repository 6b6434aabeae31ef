"""MNIST: the accuracy of every design, the masks, and where masks start from."""
