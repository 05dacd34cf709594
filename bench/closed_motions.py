"""Motions in closed form: the sixty equations of closed_motions.txt that start with "solve", one process for each
solver and equation, which is stopped after LIMIT seconds.  Every answer is put into its equation by numbers, at random
points with random constants and parameters (see residual and relations below), in 30 digits; the general solution has
two constants that count.

    closed_motions.py [answers]     solves, prints a table and the totals; keeps the answers, if a file is named
    closed_motions.py answers --again   checks kept answers once more

LIMIT: seconds for an equation (20).  SOLVERS: some of solve_motion field_method ode2 contrib_ode sympy.
ONLY: the numbers of some equations."""
import json
import os
import random
import re
import resource
import signal
import subprocess
import sys
import time

import mpmath as mp

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(HERE)
LIMIT = float(os.environ.get("LIMIT", 20))
SOLVERS = os.environ.get("SOLVERS", "solve_motion field_method ode2 contrib_ode sympy").split()
OURS = "solve_motion", "field_method"
QUESTION = re.compile(r"^(Is|Are|Does|Do) .*(\?|positive|negative|integer|zero)")
NAME = re.compile(r"[%A-Za-z_][%A-Za-z_0-9]*")
WORDS = {"solved": "yes", "part": "part", "wrong": "WRONG", "unchecked": "?", "none": "-", "late": "late",
         "question": "ask", "error": "err", "absent": "n/a"}


def table():
    only = os.environ.get("ONLY", "").split()
    for line in open(os.path.join(HERE, "closed_motions.txt")).readlines():
        if line.startswith("solve "):
            number, equation = line[6:].split("|")
            if not only or number.strip() in only:
                yield number.strip(), equation.strip()


# ---- the solvers: [seconds, outcome or None, alternatives], an alternative being a list of relations [left, right]

def with_maxima(solver, equation):
    front = 'front : "%s/share/anmech/anmech.mac"$ ' % ROOT if solver in OURS else ""
    command = '%sload("%s/closed_motions_solve.mac")$ answer(%s, "%s")$' % (front, HERE, solver, equation)
    start = time.time()
    process = subprocess.Popen([ROOT + "/rtest/setup/run_maxima.sh", "--very-quiet", "--batch-string=" + command],
                               env=dict(os.environ, TIMEOUT=str(int(LIMIT + 10))), stdout=subprocess.PIPE,
                               stderr=subprocess.STDOUT, text=True, errors="replace", start_new_session=True)
    found = None
    line = ""
    for line in process.stdout:
        found = re.match(r"ANSWER ([0-9.eE+-]+) (\w+) ?(.*)$", line)
        if found or QUESTION.search(line):
            break
    late = time.time() - start > LIMIT and not found
    asked = not found and QUESTION.search(line)
    if process.poll() is None and not found:
        os.killpg(process.pid, signal.SIGTERM)
    process.stdout.close()
    process.wait()
    if found:
        seconds, word, answer = found.groups()
        if float(seconds) > LIMIT:
            return LIMIT, "late", []
        return float(seconds), None if word == "found" else word, json.loads(answer) if word == "found" else []
    if late and not asked:
        return LIMIT, "late", []
    return time.time() - start, "question" if asked else "error", []


def in_a_process(work, seconds):
    """What work() returns, None if its process was stopped after so many seconds of the processor; and the seconds."""
    inside, outside = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(inside)
        resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))
        signal.setitimer(signal.ITIMER_PROF, seconds)
        try:
            answer = work()
        except BaseException as problem:
            answer = ["error", repr(problem)[:200]]
        with os.fdopen(outside, "w") as pipe:
            pipe.write(json.dumps(answer))
        os._exit(0)
    os.close(outside)
    with os.fdopen(inside) as pipe:
        text = pipe.read()
    used = os.wait4(child, 0)[2]
    return json.loads(text) if text else None, used.ru_utime + used.ru_stime


def with_sympy(equation):
    import sympy as sm
    x, f = sm.Symbol("x"), sm.Function("y")
    names = {n: sm.Symbol(n) for n in NAME.findall(equation)}
    names = {n: s for n, s in names.items() if not hasattr(sm, n) or n in ("nu", "beta")}
    left = sm.parse_expr(equation.replace("^", "**").replace("abs(", "Abs("), local_dict=names)
    left = left.subs({sm.Symbol("w"): f(x).diff(x, 2), sm.Symbol("v"): f(x).diff(x), sm.Symbol("y"): f(x)})

    def work():
        try:
            found = sm.dsolve(left, f(x))
        except NotImplementedError:
            return ["none", []]
        found = found if isinstance(found, list) else [found]
        if any(e.has(sm.Order) or e.has(sm.Derivative) or e.has(sm.Subs) for e in found):
            return ["none", []]
        return ["", [[[str(side.replace(f, lambda _: sm.Symbol("y"))) for side in e.args]] for e in found]]

    answer, seconds = in_a_process(work, LIMIT)
    if answer is None or seconds > LIMIT:
        return LIMIT, "late", []
    if answer[0] == "error":
        return seconds, "error", []
    return seconds, answer[0] or None, answer[1]


# ---- the check: numbers only

class Unknown(Exception):
    pass


# Indefinite integrals begin at BASE_x or BASE_y, near the point, else at BASE: any antiderivative serves.
BASE = mp.mpf("0.37")


def kummer_u(a, b, z):
    return mp.hyperu(a, b, z)


FUNCTIONS = {
    "exp": mp.exp, "log": mp.log, "sqrt": mp.sqrt, "sin": mp.sin, "cos": mp.cos, "tan": mp.tan, "cot": mp.cot,
    "sec": mp.sec, "csc": mp.csc, "sinh": mp.sinh, "cosh": mp.cosh, "tanh": mp.tanh, "coth": mp.coth, "sech": mp.sech,
    "csch": mp.csch, "asin": mp.asin, "acos": mp.acos, "atan": mp.atan, "acot": mp.acot, "asinh": mp.asinh,
    "acosh": mp.acosh, "atanh": mp.atanh, "acoth": mp.acoth, "abs": abs, "Abs": abs, "sign": mp.sign, "signum": mp.sign,
    "atan2": lambda a, b: mp.atan2(a, b), "gamma": mp.gamma, "erf": mp.erf, "erfi": mp.erfi, "erfc": mp.erfc,
    "Ei": mp.ei, "expintegral_ei": mp.ei, "expint": mp.expint, "expintegral_e": mp.expint, "expintegral_e1": mp.e1,
    "li": mp.li, "bessel_j": mp.besselj, "bessel_y": mp.bessely, "bessel_i": mp.besseli, "bessel_k": mp.besselk,
    "besselj": mp.besselj, "bessely": mp.bessely, "besseli": mp.besseli, "besselk": mp.besselk,
    "airyai": mp.airyai, "airybi": mp.airybi, "airy_ai": mp.airyai, "airy_bi": mp.airybi,
    "gamma_incomplete": lambda a, z: mp.gammainc(a, z), "uppergamma": lambda a, z: mp.gammainc(a, z),
    "lowergamma": lambda a, z: mp.gammainc(a, 0, z), "hyper": lambda a, b, z: mp.hyper(a, b, z),
    "hypergeometric": lambda a, b, z: mp.hyper(a, b, z), "kummer_m": mp.hyp1f1, "kummer_u": kummer_u,
    "gauss_a": mp.hyp2f1, "gauss_b": lambda a, b, c, z: mp.hyp2f1(a, b, a + b - c + 1, 1 - z),
    "parabolic_cylinder_d": mp.pcfd, "elliptic_f": lambda p, m: mp.ellipf(p, m), "elliptic_e": mp.ellipe,
    "elliptic_kc": mp.ellipk, "whittaker_m": mp.whitm, "whittaker_w": mp.whitw,
    "jacobi_sn": lambda u, m: mp.ellipfun("sn", u, m=m), "jacobi_cn": lambda u, m: mp.ellipfun("cn", u, m=m),
    "jacobi_dn": lambda u, m: mp.ellipfun("dn", u, m=m), "LambertW": mp.lambertw, "Tuple": lambda *l: list(l),
    "Rational": lambda a, b: mp.mpf(a)/b, "re": mp.re, "im": mp.im}
NUMBERS = {"%e": mp.e, "%pi": mp.pi, "%i": mp.j, "E": mp.e, "pi": mp.pi, "I": mp.j}


def integrals(text):
    """integrate(f, u) and Integral(f, u) or Integral(f, (u, a, b)) as integral(lambda u: f, a, b)."""
    found = re.search(r"'?\b(integrate|Integral)\(", text)
    if not found:
        return text
    depth, cuts, here = 1, [found.end()], found.end()
    while depth:
        c = text[here]
        depth += (c in "([") - (c in ")]")
        if (c == "," and depth == 1) or not depth:
            cuts.append(here)
        here += 1
    parts = [text[a + (k > 0):b].strip() for k, (a, b) in enumerate(zip(cuts, cuts[1:]))]
    if len(parts) == 2 and parts[1].startswith("("):
        parts = parts[:1] + [p.strip() for p in parts[1].strip("()").split(",")]
    integrand, variable = parts[:2]
    variable = variable.strip("()")
    base = "BASE_" + variable if variable in ("x", "y") else "BASE"
    limits = parts[2:] if len(parts) == 4 else [base, parts[2] if len(parts) == 3 else variable]
    return "%s INTEGRAL_(lambda %s: %s, %s, %s)%s" % (text[:found.start()], variable, integrals(integrand), limits[0],
                                                     limits[1], integrals(text[here:]))


def python(text):
    return re.sub(r"(?<![\w.])(\d+\.?\d*(?:[eE][+-]?\d+)?)(?![\w.])", r"mpf('\1')",
                  integrals(text).replace("^", "**").replace("%", "P_")).strip()


class Relation:
    """A text as a function of the values of its names."""

    def __init__(self, text):
        if "diff(" in text or "Derivative" in text:
            raise Unknown("derivative")
        self.code = compile(python(text), "answer", "eval")
        self.names = {n for n in NAME.findall(text)} - {"integrate", "Integral"}
        self.scope = {"P_" + n[1:] if n[0] == "%" else n: f for n, f in {**FUNCTIONS, **NUMBERS}.items()}
        self.scope.update(BASE=BASE, mpf=mp.mpf, INTEGRAL_=lambda f, a, b: mp.quad(f, [a, b], maxdegree=8))
        for n in self.names:
            if re.search(r"(?<![\w%])" + re.escape(n) + r"\(", text) and n not in FUNCTIONS:
                raise Unknown(n)

    def __call__(self, values):
        return eval(self.code, {**self.scope, **{k.replace("%", "P_"): u for k, u in values.items()}})


def draw(names):
    return {n: mp.mpf(random.choice((1, 1, 1, -1)))*random.randint(20, 180)/101 for n in names}


def partial(f, values, *names):
    """The derivative of f at values by the names, one after the other."""
    orders = [names.count(n) for n in sorted(set(names))]
    at = [values[n] for n in sorted(set(names))]
    return mp.diff(lambda *u: f({**values, **dict(zip(sorted(set(names)), u))}), tuple(at), tuple(orders))


def small(rest, *terms):
    return abs(rest) <= mp.mpf("1e-9")*(sum(abs(u) for u in terms) + mp.mpf("1e-9"))


def counts(rows):
    """Whether the two rows, derivatives by the constants, are independent."""
    pairs = [(i, j) for i in range(len(rows[0])) for j in range(i)]
    return any(abs(rows[0][i]*rows[1][j] - rows[0][j]*rows[1][i])
               > mp.mpf("1e-9")*(abs(rows[0][i]*rows[1][j]) + abs(rows[0][j]*rows[1][i]) + mp.mpf("1e-12"))
               for i, j in pairs)


def explicit(equation, f, velocity, values, constants):
    """y = f(x, constants): whether it solves, whether it is general."""
    at = dict(values, y=f(values), v=partial(f, values, "x"), w=partial(f, values, "x", "x"))
    rest, other = equation(at), equation(dict(at, w=at["w"] + 1))
    good = small(rest, (other - rest)*at["w"], rest - (other - rest)*at["w"])
    if velocity:
        good = good and small(velocity(at) - at["v"], at["v"])
    rows = [[partial(f, values, c) for c in constants], [partial(f, values, "x", c) for c in constants]]
    return good, counts(rows)


def implicit(equation, g, others, values, constants):
    """g(x, y, constants) = 0, solved for one of the constants at a random y; the other relations hold v."""
    for unknown in reversed(constants):
        try:
            root = mp.findroot(lambda c: g(dict(values, **{unknown: c})), (values[unknown], values[unknown] + mp.mpf("0.1")))
            break
        except (ValueError, ZeroDivisionError):
            continue
    else:
        raise Unknown("no point")
    at = dict(values, **{unknown: root})
    gx, gy = partial(g, at, "x"), partial(g, at, "y")
    v = -gx/gy
    w = -(partial(g, at, "x", "x") + 2*v*partial(g, at, "x", "y") + v**2*partial(g, at, "y", "y"))/gy
    at.update(v=v, w=w)
    rest, other = equation(at), equation(dict(at, w=w + 1))
    good = small(rest, (other - rest)*w, rest - (other - rest)*w)
    good = good and all(abs(h(at)) < mp.mpf("1e-9")*(1 + abs(v)) for h in others)
    rows = [[partial(g, at, c) for c in constants],
            [partial(g, at, "x", c) + v*partial(g, at, "y", c) for c in constants]]
    return good, counts(rows)


def with_velocity(equation, relations, values, constants):
    """Two relations of x, y, v and two constants: solved for the constants, they must stay what they are."""
    names = constants[:2]
    for unknowns in names, ["v", names[1]], ["v", names[0]]:
        try:
            roots = mp.findroot(lambda *u: [g(dict(values, **dict(zip(unknowns, u)))) for g in relations],
                                [values[n] for n in unknowns])
            break
        except (ValueError, ZeroDivisionError):
            continue
    else:
        raise Unknown("no point")
    at = dict(values, **dict(zip(unknowns, roots)))
    rest = equation(dict(at, w=mp.mpf(0)))
    w = -rest/(equation(dict(at, w=mp.mpf(1))) - rest)
    good = True
    for g in relations:
        terms = partial(g, at, "x"), at["v"]*partial(g, at, "y"), w*partial(g, at, "v")
        good = good and small(sum(terms), *terms)
    return good, counts([[partial(g, at, c) for c in names] for g in relations])


def solved_for(name, left, right):
    if left.strip() == name and not re.search(r"(?<!\w)%s(?!\w)" % name, right):
        return right
    if right.strip() == name and not re.search(r"(?<!\w)%s(?!\w)" % name, left):
        return left


def check_alternative(equation, relations):
    """solved, part (fewer than two constants), wrong, unchecked."""
    left = Relation(equation)
    if any("diff(" in side or "Derivative" in side for pair in relations for side in pair):
        return "part"
    pairs = [[a.strip(), b.strip()] for a, b in relations]
    explicit_y = next(filter(None, (solved_for("y", a, b) for a, b in pairs)), None)
    explicit_v = next(filter(None, (solved_for("v", a, b) for a, b in pairs)), None)
    f = g = velocity = None
    if explicit_y is not None:
        f = Relation(explicit_y)
        if explicit_v is not None and len(pairs) > 1:
            velocity = Relation(explicit_v)
        everything = f.names
    else:
        g = [Relation("(%s) - (%s)" % (a, b)) for a, b in pairs]
        everything = set().union(*(h.names for h in g))
        if not everything & {"y", "v"}:
            raise Unknown("parametric")
        alone = next((h for h in g if "v" not in h.names and "y" in h.names), None)
        others = [h for h in g if h is not alone]
        if alone and any("v" not in h.names for h in others):
            return "unchecked"
    parameters = left.names - set("xyvw") - set(FUNCTIONS)
    constants = sorted(everything - parameters - set("xyvw") - set(FUNCTIONS) - set(NUMBERS) - {"P_e"})
    if explicit_y is None and (len(constants) < 2 or (not alone and len(g) < 2)):
        return "part"
    good = bad = general = 0
    for trial in range(16):
        values = draw(parameters | set(constants))
        values.update(x=abs(draw("x")["x"]), y=abs(draw("y")["y"]), v=draw("v")["v"])
        values.update({p: abs(values[p]) for p in parameters})
        values.update(BASE_x=values["x"]*mp.mpf("0.98"), BASE_y=values["y"]*mp.mpf("0.98"))
        try:
            if f:
                answer, rank = explicit(left, f, velocity, values, constants)
            elif alone and len(constants) > 1:
                answer, rank = implicit(left, alone, others, values, constants)
            else:
                answer, rank = with_velocity(left, g, values, constants)
        except (ValueError, ZeroDivisionError, OverflowError, Unknown, mp.NoConvergence):
            continue
        good, bad, general = good + answer, bad + (not answer), general + (answer and rank)
        if good == 3 or (bad == 5 and not good):
            break
    if good >= 2:
        return "solved" if general >= 2 else "part"
    return "wrong" if bad > 1 and not good else "unchecked"


def check(equation, alternatives):
    """The worst that is said of an alternative counts, but solved before part: a family may have singular companions."""
    def work():
        mp.mp.dps = 30
        random.seed(7)
        words = []
        for relations in alternatives:
            try:
                words.append(check_alternative(equation, relations))
            except (Unknown, NameError, TypeError, SyntaxError, NotImplementedError, AttributeError) as problem:
                if os.environ.get("DEBUG"):
                    print(equation, relations, repr(problem), file=sys.stderr)
                words.append("unchecked")
        return words
    words = in_a_process(work, 60)[0]
    if not words or words[0] == "error":
        if os.environ.get("DEBUG"):
            print(equation, words, file=sys.stderr)
        return "unchecked"
    return next(w for w in ("wrong", "solved", "unchecked", "part") if w in words)


# ---- the table

def main(kept, again):
    answers = {}
    if again:
        answers = {(r[0], r[1]): r[2:] for r in map(json.loads, open(kept))}
    log = open(kept, "a") if kept and not again else None
    totals = {s: {"seconds": 0.0} for s in SOLVERS}
    absent = set()
    print("closed motions %-7s" % "Kamke" + "".join("%20s" % s for s in SOLVERS), flush=True)
    for number, equation in table():
        row = []
        for solver in SOLVERS:
            if again and (number, solver) not in answers:
                row.append(16*" " + "    ")
                continue
            if again:
                seconds, word, found = answers[number, solver]
            elif solver in absent:
                seconds, word, found = 0.0, "absent", []
            else:
                seconds, word, found = with_sympy(equation) if solver == "sympy" else with_maxima(solver, equation)
            if word == "absent":
                absent.add(solver)
            if log:
                log.write(json.dumps([number, solver, seconds, word, found]) + "\n")
                log.flush()
            if os.environ.get("NOCHECK"):
                word = word or "unchecked"
            word = word or (check(equation, found) if found else "none")
            kind = totals[solver].setdefault((number[0], word), 0)
            totals[solver][number[0], word] = kind + 1
            totals[solver]["seconds"] += seconds
            row.append("%11s %6.2f s" % (WORDS[word], seconds))
        print("closed motions %-7s" % number + "".join(row), flush=True)
    print("\nclosed motions: outcome, of the linear (2.x) and of the nonlinear equations (6.x); seconds in all, %g s for "
          "what was late" % LIMIT)
    print("closed motions: yes a general solution, part less than that, WRONG and ? by the check, - nothing found, err an error, "
          "ask a question, n/a no such verb")
    for word in WORDS:
        if any((c, word) in totals[s] for s in SOLVERS for c in "26"):
            print("closed motions %-7s" % WORDS[word] + "".join(
                "%20s" % ("%d + %d" % (totals[s].get(("2", word), 0), totals[s].get(("6", word), 0))) for s in SOLVERS))
    print("closed motions %-7s" % "time" + "".join("%18.1f s" % totals[s]["seconds"] for s in SOLVERS))


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None, "--again" in sys.argv)
