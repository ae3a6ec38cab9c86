"""``python -m swarmchase_tracker``."""

from . import main

if __name__ == "__main__":
    main()
