"""From one state to the next: a step, its substeps and events, and the stages that are made of steps."""
