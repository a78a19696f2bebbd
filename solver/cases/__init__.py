"""Cases: geometry and scene of one structure each."""
