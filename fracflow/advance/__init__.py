"""From one state to the next: one step, substeps, events, error control; stages, and the change between rest and motion.

A stage makes a ``LoadStep`` for each of its steps, and asks for it, or what is left of it, by a ``StepRequest``. Every way to
advance takes a state and a request, and gives an ``Outcome``; a way may wrap another one, and hands a shorter request on.
``stage.composed`` says which wrap which. Calls go down only:

UpToLimitPoint > Substepped > SplitAtJumps > ErrorControlled > EventLocated or StableSlip > SingleStep or ExplicitSubsteps
> solve.StepProblem
"""
