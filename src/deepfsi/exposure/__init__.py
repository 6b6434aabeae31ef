"""What is shown when, and what it tells: a kind of exposure each."""
