"""npy and npz."""
