# SPDX-License-Identifier: Apache-2.0
"""C source of an assembled model: the functions of `assembly` with their derivatives, and the loops of `bench_model.c`.

The source needs only a C99 compiler and its mathematics library, so that a box can run it too.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib import resources

import casadi
from casadi import SX

from hydro_core.signals import SAMPLE_PERIOD
from hydro_sim.model.assembly import Functions
from hydro_sim.model.equations import READINGS

NamedExpressions = Sequence[tuple[str, SX]]
"""Arguments of a C function, or its results."""
_FOLDER = resources.files("hydro_sim.model")


def c_source(model: Functions, substeps: int, *, derivatives: bool = True, sensitivities: bool = False) -> str:
    """Return the whole source as one text; without derivatives it compiles in a fifth of the time.

    `sensitivities`: with the loops of `bench_sensitivities.c`, by any number of directions at once.
    """
    functions = [*_functions(model, "once begin enter step read rates"), *(_tangents(model) if derivatives else [])]
    sizes = {"N": model.y, "M": model.k, "P": model.theta, "RATES": model.rates}
    head = "".join(f"#define {name} {symbols.numel()}\n" for name, symbols in sizes.items())
    head += f"#define SUBSTEPS {substeps}\n" + "#define DERIVATIVES\n" * derivatives
    files = ["bench_model.c"]
    if sensitivities:
        once = casadi.sparsify(casadi.jacobian(model.once, model.theta))
        at, step, read = _inputs(model), _partial(model.step, model), _partial(model.read, model)
        files.append("bench_sensitivities.c")
        functions += [
            ("once_partials", [("theta", model.theta)], [("out", model.once), ("partials", once.nz[:])]),
            ("step_partials", at, [("out", model.step), ("partials", step.nz[:])]),
            ("read_partials", at[:2], [("z", model.read), ("partials", read.nz[:])]),
        ]
        head += f"#define HELD {model.y.numel() - model.past_currents}\n"
        for name, matrix in (("ONCE", once), ("STEP", step), ("READ", read)):
            rows, columns = matrix.sparsity().get_triplet()
            head += f"#define {name}_PARTIALS {len(rows)}\n"
            for word, places in (("ROW", rows), ("COLUMN", columns)):
                head += f"static const short {name}_{word}[] = {{{', '.join(map(str, places))}}};\n"
    body = "\n".join(_function(*entry) for entry in functions)
    loops = "\n".join((_FOLDER / file).read_text(encoding="utf-8") for file in files)
    return f"#include <math.h>\n{head}\n{body}\n{loops}"


def exported_source(model: Functions, substeps: int) -> str:
    """Return the C source for `hydro_sim.export`, without loops; all names begin with `hydro_`."""
    sizes = {"STATES": model.y, "COEFFICIENTS": model.k, "PARAMETERS": model.theta, "MOTION": model.motion}
    head = "".join(f"#define HYDRO_{name} {symbols.numel()}\n" for name, symbols in sizes.items())
    head += f"#define HYDRO_SUBSTEPS {substeps}\n#define HYDRO_STEP ({SAMPLE_PERIOD!r} / HYDRO_SUBSTEPS) /* s */\n"
    functions = _functions(model, "once rest begin enter step read motion")
    return head + "\n" + _with_used("\n".join(_function(f"hydro_{name}", *rest) for name, *rest in functions))


def embedded_source(model: Functions, substeps: int, prefix: str, *, jacobian: bool) -> str:
    """Return `all_rates`, and `all_sample` or `all_jacobian`, for a box in C (firmware/hydro/loop.h), behind `prefix_`.

    Raises ValueError: the model needs a mathematical function that a box does not have.
    """
    functions = _functions(model, "rates enter") + (_tangents(model) if jacobian else _functions(model, "step read"))
    wanted = ["rates", "jacobian" if jacobian else "sample"]
    loops = (_FOLDER / "bench_model.c").read_text(encoding="utf-8")
    cut = [re.search(rf"^void bench_{one}.*?^}}\n", loops, re.MULTILINE | re.DOTALL) for one in wanted]
    text = "\n".join(_function(*entry) for entry in functions)
    text += "\n".join(found[0].replace("void bench_", "static void all_") for found in cut if found is not None)
    numbers = {"N": model.y.numel(), "SUBSTEPS": substeps, "Z": len(READINGS), "RATES": model.rates.numel()}
    for name, number in numbers.items():
        text = re.sub(rf"\b{name}\b", str(number), text)
    names = [*(name for name, _, _ in functions), *(f"all_{one}" for one in wanted)]
    for pattern, becomes in (
        (rf"\b({'|'.join(names)})\(", rf"{prefix}_\1("), (r"\bdouble\b", "hydro_real"),
        (r"(?<![\w.])(\d+\.\d*(e[+-]?\d+)?|\d+e[+-]?\d+)", r"HYDRO_R(\1)"),
        (r"= (a\d+ (<|<=|==|!=|&&|\|\|) a\d+|!a\d+);", r"= HYDRO_R(\1);"),
        (r"= (\(a\d+ > \S+\) - \(a\d+ < \S+\));", r"= HYDRO_R(\1);"),
        (r"\bmemcpy\(", "hydro_copy("), (r"\bsqrt\(", "HYDRO_SQRT("), (r"\bexp\(", "HYDRO_EXP("),
        (r"\bfabs\(", "hydro_abs("), (r"\bcopysign\(", "hydro_copysign("),
    ):  # fmt: skip
        text = re.sub(pattern, becomes, text)
    if missing := re.search(r"\b(log|pow|sin|cos|tanh|floor|log1p|expm1)\(", text):
        raise ValueError(f"the model needs {missing[1]}(), which a box in C does not have")
    return _with_used(text)


def _with_used(text: str) -> str:
    """The text with functions in which no argument is unused."""

    def marked(head: re.Match[str]) -> str:
        names = [word.split()[-1].lstrip("*") for word in head[2].split(",")]
        return head[1] + "".join(f"    (void){name};\n" for name in names)

    return re.sub(r"(static void \w+\((.*?)\)\n\{\n)", marked, text, flags=re.DOTALL)


def _inputs(model: Functions) -> list[tuple[str, SX]]:
    return [("k", model.k), ("y", model.y), ("u", model.current), ("share", model.share)]


def _functions(model: Functions, names: str) -> list[tuple[str, NamedExpressions, NamedExpressions]]:
    """Functions of a model by name, with their arguments in C."""
    at = _inputs(model)
    inputs: dict[str, NamedExpressions] = {
        "once": [("theta", model.theta)], "rest": at[:1], "begin": at[:2], "enter": at[1:3], "step": at, "read": at[:2],
        "rates": at, "motion": [*at, ("slide", model.slide)],
    }  # fmt: skip
    return [(name, inputs[name], [("z" if name == "read" else "out", getattr(model, name))]) for name in names.split()]


def _tangents(model: Functions) -> list[tuple[str, NamedExpressions, NamedExpressions]]:
    """Propagation of d y/d(y, u), D of shape (N, N + 1)."""
    at, states = _inputs(model), model.y.numel()
    d = SX.sym("D", states, states + 1)

    def moved(outcome: SX) -> SX:
        by_current = casadi.horzcat(SX.zeros(states, states), casadi.jacobian(outcome, model.current))
        return (casadi.jacobian(outcome, model.y) @ d + by_current).T

    z = [("z", model.read), ("dz", (casadi.jacobian(model.read, model.y) @ d).T)]
    return [
        ("enter_tangent", [("D", d)], [("out", moved(model.enter))]),
        ("step_tangent", [*at, ("D", d)], [("out", model.step), ("moved", moved(model.step))]),
        ("read_tangent", [*at[:2], ("D", d)], z),
    ]


def _partial(outcome: SX, model: Functions) -> SX:
    """d outcome/d(y, k): rows of past currents, which nothing changes, and columns by them left out."""
    held = model.y.numel() - model.past_currents
    jacobian = casadi.horzcat(casadi.jacobian(outcome, model.y)[:, :held], casadi.jacobian(outcome, model.k))
    return casadi.sparsify(jacobian[:held, :] if outcome.numel() == model.y.numel() else jacobian)


def _function(name: str, inputs: NamedExpressions, outputs: NamedExpressions) -> str:
    """A C function, from CasADi's list of elementary operations."""
    dense = [casadi.densify(casadi.cse(expression)) for _, expression in outputs]
    function = casadi.Function(name, [symbol for _, symbol in inputs], dense)
    column = {index: symbol.is_scalar() for index, (_, symbol) in enumerate(inputs)}
    lines, used = [], set()
    for i in range(function.n_instructions()):
        operation = function.instruction_id(i)
        read, written = function.instruction_input(i), function.instruction_output(i)
        if operation == casadi.OP_OUTPUT:
            lines.append(f"{outputs[written[0]][0]}[{written[1]}] = a{read[0]};")
            continue
        if operation == casadi.OP_INPUT:
            label = inputs[read[0]][0]
            if label == "D":  # by rows in C, by columns in CasADi
                rows, columns = inputs[read[0]][1].shape
                value = f"D[{(read[1] % rows) * columns + read[1] // rows}]"
            else:
                value = label if column[read[0]] else f"{label}[{read[1]}]"
        elif operation == casadi.OP_CONST:
            value = repr(function.instruction_constant(i))
        else:
            value = _OPERATIONS[operation].format(*(f"a{one}" for one in read))
        lines.append(f"a{written[0]} = {value};")
        used.add(written[0])
    words = [f"double {label}" if column[i] else f"const double *{label}" for i, (label, _) in enumerate(inputs)]
    words += [f"double *restrict {label}" for label, _ in outputs]
    declared = f"    double {', '.join(f'a{one}' for one in sorted(used))};\n" if used else ""
    text = "\n".join(f"    {line}" for line in lines)
    return f"static void {name}({', '.join(words)})\n{{\n{declared}{text}\n}}\n"


_OPERATIONS = {
    casadi.OP_ASSIGN: "{0}", casadi.OP_ADD: "{0} + {1}", casadi.OP_SUB: "{0} - {1}", casadi.OP_MUL: "{0} * {1}",
    casadi.OP_DIV: "{0} / {1}", casadi.OP_NEG: "-{0}", casadi.OP_EXP: "exp({0})", casadi.OP_LOG: "log({0})",
    casadi.OP_POW: "pow({0}, {1})", casadi.OP_CONSTPOW: "pow({0}, {1})", casadi.OP_SQRT: "sqrt({0})",
    casadi.OP_SQ: "{0} * {0}", casadi.OP_TWICE: "2.0 * {0}", casadi.OP_SIN: "sin({0})", casadi.OP_COS: "cos({0})",
    casadi.OP_TANH: "tanh({0})", casadi.OP_FLOOR: "floor({0})", casadi.OP_FABS: "fabs({0})",
    casadi.OP_INV: "1.0 / {0}", casadi.OP_LT: "{0} < {1}", casadi.OP_LE: "{0} <= {1}", casadi.OP_EQ: "{0} == {1}",
    casadi.OP_NE: "{0} != {1}", casadi.OP_NOT: "!{0}", casadi.OP_AND: "{0} && {1}", casadi.OP_OR: "{0} || {1}",
    casadi.OP_SIGN: "({0} > 0.0) - ({0} < 0.0)", casadi.OP_IF_ELSE_ZERO: "{0} ? {1} : 0.0",
    casadi.OP_FMIN: "{0} < {1} ? {0} : {1}", casadi.OP_FMAX: "{0} > {1} ? {0} : {1}",
    casadi.OP_LOG1P: "log1p({0})", casadi.OP_EXPM1: "expm1({0})", casadi.OP_COPYSIGN: "copysign({0}, {1})",
}  # fmt: skip
"""Elementary operations in C."""
