"""Growth from shapes: what pattern of contraction a body must have had to look as it does (§6.3.3).

A :class:`solver.fitting.field.Field` is β(X; p) with parameters p,
:class:`solver.fitting.elastic.Equilibria` and :class:`solver.fitting.creeping.Creep` follow a body
to the states that it leads to and tell how they change with p, targets
(:mod:`solver.fitting.targets`) are what is known of the shape, and :func:`solver.fitting.fit.fit`
finds p, how well the shape fixes it, and whether the model explains the shape at all.
"""
