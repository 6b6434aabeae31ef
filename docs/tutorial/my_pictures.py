"""Write 1797 handwritten digits of 8 × 8 pixels to my-pictures, a sub-folder for each class."""

from sklearn.datasets import load_digits

from deepfsi.datasets.display import write_pictures

digits = load_digits()
named = enumerate(zip(digits.images, digits.target, strict=True))
write_pictures(
    {f"{label}/{number:04d}.png": image / 16 for number, (image, label) in named}, "my-pictures"
)
