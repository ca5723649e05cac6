"""The networks: the path embedding F, KPCN's reconstruction network R, and the operators that apply their output."""
