"""`python -m deepfsi`."""

from deepfsi.cli import main

if __name__ == "__main__":
    main()
