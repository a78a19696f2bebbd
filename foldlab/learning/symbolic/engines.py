"""What a symbolic-regression engine may search for (:class:`Constraints`), and the two engines.

An engine is a function ``search(X, y, inputs, constraints, log_target, deadline) -> list[Tree]``:
candidates for y, in no order, not yet checked against the constraints and with constants to refit.
X has shape (n, len(inputs)), y shape (n,); with ``log_target`` both engines minimise log(A/y)².
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from foldlab.errors import InputError
from foldlab.learning.symbolic import formula as fm
from foldlab.learning.symbolic.formula import Tree
from foldlab.packaged import needed_for


@dataclass(frozen=True)
class Constraints:
    """What a formula may be, and how long the search for it may take; the same for every engine.

    operators
        Subset of ``+ - * / log``; the dissertation's five by default (§4.7.2).
    max_depth, max_size
        Limits on levels and nodes of the returned formula, counted as in
        :mod:`foldlab.learning.symbolic.formula` (a weight in front of an input counts as a
        multiplication and a number).
    forbidden_nesting
        Pairs (outer, inner): inner may occur nowhere below outer.
    seconds
        Wall-clock budget of one ``fit``, the refit of constants included.
    generations
        Optional second limit. Time is not reproducible: with one thread, the same seed gives the
        same formulas only where this limit ends the search before the time does.
    population, seed, threads
        Individuals per generation, seed, worker threads of the engine.
    """

    operators: tuple[str, ...] = fm.OPERATORS
    max_depth: int = 7
    max_size: int = 40
    forbidden_nesting: tuple[tuple[str, str], ...] = (("log", "log"),)
    seconds: float = 60.0
    generations: int | None = None
    population: int = 300
    seed: int = 0
    threads: int = 1

    def __post_init__(self):
        object.__setattr__(self, "operators", tuple(self.operators))
        object.__setattr__(
            self, "forbidden_nesting", tuple(tuple(pair) for pair in self.forbidden_nesting)
        )
        unknown = [o for o in self.operators if o not in fm.OPERATORS]
        if unknown or not self.operators:
            raise InputError(
                f"operators {', '.join(map(repr, unknown)) or '(none)'} are not usable; "
                f"choose from {' '.join(fm.OPERATORS)}"
            )
        for pair in self.forbidden_nesting:
            if len(pair) != 2 or not set(pair) <= set(fm.OPERATORS):
                raise InputError(
                    f"forbidden nesting {pair!r}; expected pairs (outer, inner) of operators, "
                    "such as ('log', 'log')"
                )
        lows = {"max_depth": 1, "max_size": 1, "population": 10, "seed": 0, "threads": 1}
        if self.generations is not None:
            lows["generations"] = 1
        for name, low in lows.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < low:
                raise InputError(f"{name} = {value!r}; expected a whole number from {low} up")
        if not (np.isfinite(self.seconds) and self.seconds > 0):
            raise InputError(f"seconds = {self.seconds!r}; expected a finite time above 0")

    def allow(self, tree: Tree) -> bool:
        """Whether a formula keeps every limit."""
        return (
            fm.size(tree) <= self.max_size
            and fm.depth(tree) <= self.max_depth
            and fm.operators(tree) <= set(self.operators)
            and bool(np.isfinite(fm.constants(tree)).all())
            and not any(fm.nests(tree, *pair) for pair in self.forbidden_nesting)
        )


# Squared log errors beyond this weigh no more: a formula that changes sign somewhere has a pole
# of log|A| there, and would otherwise lose against one that is wrong everywhere.
_CLIP = 4.0
_WORST = 1e9
_KINDS = {"Add": "+", "Sub": "-", "Mul": "*", "Div": "/", "Log": "log"}
_LM_ITERATIONS = 5
_STARTS, _START_FRACTION = 4, 0.1
_SEARCH_ROWS = 500  # of the training rows; the refit of constants uses all


def read_operon(nodes, names: dict[int, str]) -> Tree:
    """Tree from Operon's postfix nodes; ``names`` maps variable hashes to inputs."""
    stack: list[Tree] = []
    for node in nodes:
        if node.IsVariable:
            stack.append(("*", float(node.Value), names[node.HashValue]))
        elif node.IsConstant:
            stack.append(float(node.Value))
        else:
            tree = stack.pop()  # postfix, the first argument on top
            for _ in range(node.Arity - 1):
                tree = (_KINDS[node.Type.name], tree, stack.pop())
            stack.append(tree if node.Arity > 1 else (_KINDS[node.Type.name], tree))
    (tree,) = stack
    return tree


def operon(X, y, inputs, constraints: Constraints, log_target: bool, deadline: float) -> list[Tree]:
    """Candidates of Operon's NSGA-II: error against length, constants tuned by LM.

    Operon enforces length and depth in its own counting; forbidden nesting and the sign are
    penalised during the search and checked by the caller afterwards. With ``log_target`` every
    individual is log|A|, so that Levenberg–Marquardt tunes relative errors.
    Raises :class:`InputError` without ``*`` (Operon weighs every input), RuntimeError if the engine
    stops before its limits.
    """
    with needed_for("a formula"):
        import pyoperon as op
        from pyoperon.sklearn import SymbolicRegressor as Reference

    if "*" not in constraints.operators or len(inputs) == 0:
        raise InputError("Operon weighs every input: allow '*' among the operators")
    rows = np.random.default_rng(constraints.seed).permutation(len(X))[:_SEARCH_ROWS]
    target = np.log(y[rows]) if log_target else y[rows]
    dataset = op.Dataset(np.asfortranarray(np.column_stack([X[rows], target])))
    variables = sorted(dataset.Variables, key=lambda v: v.Index)
    hashes = [v.Hash for v in variables[:-1]]
    names = dict(zip(hashes, inputs, strict=True))
    everything = op.Range(0, dataset.Rows)

    words = {"+": "add", "-": "sub", "*": "mul", "/": "div", "log": "log"}
    symbols = ",".join([words[o] for o in constraints.operators] + ["constant", "variable"])

    def problem_with(symbols):
        problem = op.Problem(dataset)
        problem.TrainingRange, problem.TestRange = everything, op.Range(0, 1)
        problem.Target, problem.InputHashes = variables[-1], hashes
        problem.ConfigurePrimitiveSet(Reference._init_primitive_config(symbols))
        return problem

    # Random subtrees never contain the root's log|·|, but mutation must know the symbol:
    # for an unknown one Operon ends the run without a word.
    plain, problem = problem_with(symbols), problem_with(symbols + ",logabs" * log_target)
    plain_set, full_set = plain.PrimitiveSet, problem.PrimitiveSet
    creator = op.BalancedTreeCreator(plain_set, hashes, 0.0)
    weights = op.UniformRealCoefficientAnalyzer()
    weights.ParameterizeDistribution(0.1, 2.0)
    trees = op.UniformLengthTreeInitializer(creator)
    trees.ParameterizeDistribution(2, max(2, min(12, constraints.max_size // 2)))
    trees.MinDepth, trees.MaxDepth = 1, 1000

    root = op.NodeType.Logabs
    outer = {pair[0] for pair in constraints.forbidden_nesting}
    table = op.DispatchTable()
    spread = float(np.var(target)) or 1.0

    seconds = deadline - time.monotonic()
    until = deadline

    def error(_, individual):
        if time.monotonic() > until:
            total.Budget = 1
            return [_WORST]
        tree = individual.Genotype
        nodes = tree.Nodes
        if log_target:
            if nodes[-1].Type != root or sum(n.Type == root for n in nodes) > 1:
                return [_WORST]
            nodes = nodes[:-1]
        if any(_KINDS.get(n.Type.name) in outer for n in nodes):
            inner = read_operon(nodes, names)
            if any(fm.nests(inner, *pair) for pair in constraints.forbidden_nesting):
                return [_WORST]
        residual = op.Evaluate(table, tree, dataset, everything) - target
        if not np.isfinite(residual).all():
            return [_WORST]
        squares = np.square(residual - np.median(residual) if log_target else residual)
        return [float(np.minimum(squares, _CLIP).mean() if log_target else squares.mean() / spread)]

    budget = 2**62
    extra = int(log_target)
    # Simplification shortens depth more often than it adds to it.
    deep, long = constraints.max_depth + 1 + extra, max(3, int(0.8 * constraints.max_size)) + extra
    tuner = op.LMOptimizer(table, problem, _LM_ITERATIONS, 0)
    local_search = op.CoefficientOptimizer(tuner)
    errors, lengths = op.UserDefinedEvaluator(problem, error), op.LengthEvaluator(problem)
    total = op.MultiEvaluator(problem)
    for evaluator in (errors, lengths):
        evaluator.Budget = budget
        total.Add(evaluator)
    total.Budget = budget
    comparison = op.CrowdedComparison()
    selector = op.TournamentSelector(comparison)
    selector.TournamentSize = 3
    reinserter = op.KeepBestReinserter(comparison)
    crossover = op.SubtreeCrossover(0.9, deep, long)
    mutations = [
        op.NormalOnePointMutation(),
        op.NormalMultiPointMutation(),
        op.ChangeVariableMutation(hashes),
        op.ChangeFunctionMutation(full_set),
        op.ReplaceSubtreeMutation(creator, weights, deep, long),
        op.InsertSubtreeMutation(creator, weights, deep, long),
        op.RemoveSubtreeMutation(full_set),
    ]
    for mutation in mutations[:2]:
        mutation.ParameterizeDistribution(0, 1)
    mutate = op.MultiMutation()
    for mutation in mutations:
        mutate.Add(mutation, 1.0)
    generator = op.BasicOffspringGenerator(
        total, crossover, mutate, selector, selector, local_search
    )
    sorter = op.RankSorter()
    rng = op.RandomGenerator(np.uint64(constraints.seed))

    def strangers() -> list:
        """Random individuals: parents, and as many again for the pool of offspring."""
        nonlocal until
        until = deadline
        members = []
        for _ in range(2 * constraints.population):
            tree = trees(rng)
            weights(rng, tree)
            member = op.Individual(2)
            member.Genotype = op.Tree([*tree.Nodes, *[op.Node(root)] * extra]).UpdateNodes()
            member.SetFitness(error(rng, member)[0], 0)
            member.SetFitness(float(member.Genotype.Length), 1)
            members.append(member)
        return members

    def evolve(members: list, fraction: float) -> list:
        """Run for a fraction of the limits from given members (parents and pool)."""
        nonlocal until
        until = min(deadline, time.monotonic() + fraction * seconds)
        generations = max(1, round(fraction * (constraints.generations or 10**9)))
        total.Budget = budget
        config = op.GeneticAlgorithmConfig(
            generations=generations,
            max_evaluations=budget,
            local_iterations=_LM_ITERATIONS,
            population_size=constraints.population,
            pool_size=constraints.population,
            p_crossover=1.0,
            p_mutation=0.5,
            p_local=1.0,
            p_lamarck=1.0,
            epsilon=0,
            seed=constraints.seed,
        )
        search = op.NSGA2Algorithm(config, problem, trees, weights, generator, reinserter, sorter)
        search.RestoreIndividuals(members)
        search.IsFitted = True
        search.Run(rng, None, constraints.threads, True)
        if search.Generation < generations and time.monotonic() < until:
            raise RuntimeError(
                f"Operon stopped in generation {search.Generation}, before its limits; "
                "this is a fault of the engine's set-up, please report the constraints used"
            )
        return sorted(search.Individuals, key=lambda i: (i.GetFitness(0), i.GetFitness(1)))

    # One population settles early, sometimes on a poor form; several short ones meet in a long one.
    each = -(-constraints.population // _STARTS)
    parents = []
    for _ in range(_STARTS):
        parents += evolve(strangers(), _START_FRACTION)[:each]
    parents = parents[: constraints.population]
    final = evolve(parents + parents, 1 - _STARTS * _START_FRACTION)
    candidates = []
    for member in final:
        nodes = list(member.Genotype.Nodes)
        if member.GetFitness(0) < _WORST:
            candidates.append(
                (
                    member.GetFitness(0),
                    len(nodes),
                    read_operon(nodes[:-1] if log_target else nodes, names),
                )
            )
    return _by_length(candidates)


def _by_length(candidates: list[tuple[float, int, Tree]], keep: int = 4) -> list[Tree]:
    """The best of each length first, then the second of each, …: the order of refitting."""
    ranked, seen = [], {}
    for error, length, tree in sorted(candidates, key=lambda f: (f[0], f[1], fm.infix(f[2]))):
        earlier = seen.setdefault(length, [])
        # Equal errors at equal length are the same formula with its arguments swapped.
        if len(earlier) < keep and not any(abs(error - e) <= 1e-4 * error for e in earlier):
            earlier.append(error)
            ranked.append((len(earlier), error, tree))
    return [tree for _, _, tree in sorted(ranked, key=lambda r: r[:2])]


def julia() -> str | None:
    """Path of a Julia executable, or None. Looks only, imports and installs nothing."""
    named = os.environ.get("PYTHON_JULIAPKG_EXE") or os.environ.get("PYTHON_JULIACALL_EXE")
    own = Path(sys.prefix) / "julia_env" / "pyjuliapkg" / "install" / "bin" / "julia"
    for candidate in (named, "julia", str(own)):
        if candidate and (path := shutil.which(candidate)):
            return path
    return None


def pysr_arguments(constraints: Constraints, log_target: bool, seconds: float) -> dict:
    """The constraints in the words of ``pysr.PySRRegressor``."""
    nested: dict[str, dict[str, int]] = {}
    for outer, inner in constraints.forbidden_nesting:
        if {outer, inner} <= set(constraints.operators):
            nested.setdefault(outer, {})[inner] = 0
    serial = constraints.threads == 1
    return {
        "binary_operators": [o for o in constraints.operators if o in fm.BINARY],
        "unary_operators": [o for o in constraints.operators if o in fm.UNARY],
        "maxsize": constraints.max_size,
        "maxdepth": constraints.max_depth,
        "nested_constraints": nested or None,
        "elementwise_loss": (
            "loss(a, y) = log(abs(a / y) + 1e-300)^2" if log_target else "L2DistLoss()"
        ),
        "timeout_in_seconds": seconds,
        "niterations": constraints.generations or 10**9,
        # PySR is deterministic in serial only, and wants both said.
        "parallelism": "serial" if serial else "multithreading",
        "deterministic": serial,
        "random_state": constraints.seed if serial else None,
        "precision": 64,
        "print_precision": 17,
        "model_selection": "accuracy",
        "verbosity": 0,
        "progress": False,
        "temp_equation_file": True,
        "input_stream": "devnull",
    }


def pysr(X, y, inputs, constraints: Constraints, log_target: bool, deadline: float) -> list[Tree]:
    """Candidates of PySR: its hall of fame.

    Raises :class:`InputError` where the package or Julia is missing; it never downloads Julia
    (importing pysr without Julia would). The first use installs PySR's Julia packages.
    """
    if importlib.util.find_spec("pysr") is None:
        raise InputError(
            "engine 'pysr' needs the package pysr: pip install 'foldlab[pysr]', "
            "or use engine='operon'"
        )
    executable = julia()
    if executable is None:
        raise InputError(
            "engine 'pysr' needs Julia and found none: install Julia 1.10 or later "
            "(julialang.org/downloads), put it on the PATH, or use engine='operon'"
        )
    if constraints.max_size < 7:
        raise InputError(f"max_size = {constraints.max_size}; PySR takes sizes from 7 up")
    os.environ.setdefault("PYTHON_JULIAPKG_EXE", executable)
    from pysr import PySRRegressor

    seconds = max(1.0, deadline - time.monotonic())
    model = PySRRegressor(**pysr_arguments(constraints, log_target, seconds))
    model.fit(X, y, variable_names=list(inputs))
    return [fm.parsed(text, inputs) for text in model.equations_["equation"]]


ENGINES = {"operon": operon, "pysr": pysr}
