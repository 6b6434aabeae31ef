"""What a trained design does with its masks, and what it is told: a kind of exposure each."""
