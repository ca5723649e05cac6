"""`python -m pathfold` is the `pathfold` command."""

from pathfold.cli import main

if __name__ == "__main__":
    main()
