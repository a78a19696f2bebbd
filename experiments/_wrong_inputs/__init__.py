"""Parts of the experiment wrong_inputs: good files, what is done to them, and how it is judged."""
