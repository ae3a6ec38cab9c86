"""What all tests share."""

import torch

# One thread: tests compare small batches, where more threads only wait for one another.
torch.set_num_threads(1)
