"""The tasks of symmetries.mac, read from its output (first argument), with delierium and SymPy: a table of what each
finds and how long it takes, CPU seconds, imports not counted.  Every task of delierium has a process of its own, which
is stopped after LIMIT seconds."""
import json
import os
import resource
import subprocess
import sys
import time

import sympy as sm

LIMIT = int(os.environ.get("LIMIT", 60))
t = sm.Symbol("t")


def equations(task):
    """x'' - f for the right sides as Maxima writes them."""
    unknown = {name: sm.Function(name)(t) for name in task["variables"]}
    names = {**unknown, "t": t, "E": sm.E, "diff": lambda f, variable, order=1: f.diff(variable, order)}
    right = [sm.parse_expr(f.replace("'diff", "diff").replace("^", "**").replace("%e", "E"), local_dict=names)
             for f in task["right_sides"]]
    positive = {p: sm.Symbol(p.name, positive=True) for f in right for p in f.free_symbols if p != t}
    unknown = list(unknown.values())
    return [x.diff(t, task["order"]) - f.subs(positive) for x, f in zip(unknown, right)], unknown


def with_delierium(task):
    from delierium import lie_symmetries
    left, unknown = equations(task)
    one = len(unknown) == 1
    start = time.process_time()
    found = lie_symmetries(left[0] if one else left, unknown[0] if one else unknown, t)
    dimension = int(found.dimension)
    print(json.dumps([dimension, time.process_time() - start, None, None]), flush=True)
    generators = found.generators()
    complete = bool(found.complete(generators))
    print(json.dumps([dimension, time.process_time() - start, len(generators), complete]), flush=True)


def with_sympy(task):
    from sympy.solvers.ode import infinitesimals
    left, unknown = equations(task)
    if len(unknown) > 1:
        return "one equation at a time only"
    try:
        return str(len(infinitesimals(left[0], func=unknown[0])))
    except NotImplementedError:
        return "not implemented"


def limit_time():
    resource.setrlimit(resource.RLIMIT_CPU, (LIMIT, LIMIT))


def in_a_process(task):
    """The two lists that with_delierium prints, each None if not reached."""
    process = subprocess.run([sys.executable, __file__, "--task", json.dumps(task)], preexec_fn=limit_time,
                             stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    rows = [json.loads(line) for line in process.stdout.splitlines()]
    return rows[0] if rows else None, rows[1] if len(rows) > 1 else None


def row(dimension, seconds, generators, complete, total):
    return "%3s %6.2f %3s %-3s %6.2f" % (dimension, seconds, generators, "all" if complete else "", total)


def show(task, dimension, whole):
    """The ratio is that of the times for all generators, of LIMIT to ours (>) where delierium was not ready by then."""
    ours = row(*(task[key] for key in ("dimension", "seconds", "generators", "complete", "total")))
    noether = "%2s/%-2s %6.2f" % (task["noether"], task["noether_known"], task["noether_seconds"]) \
        if task["noether_known"] else 12*" "
    found, seconds = dimension[:2] if dimension else ("-", LIMIT)
    theirs = row(found, seconds, *(whole[2:] + [whole[1]] if whole else ["-", False, LIMIT]))
    ratio = "%s%.0f" % ("" if whole else ">", (whole[1] if whole else LIMIT) / max(task["total"], 0.01))
    print("symmetries %-27s %3s | %s | %s | %s | %7s | %s" % (task["name"], task["known"], ours, noether, theirs, ratio,
                                                            with_sympy(task)), flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "--task":
        with_delierium(json.loads(sys.argv[2]))
    else:
        print("symmetries %-27s dim | %25s | %12s | %25s |   ratio | SymPy" % (
            "", "anmech: dim, s, all, s", "Noether, s", "delierium: dim, s, all, s"))
        for line in open(sys.argv[1]):
            if line.startswith("{"):
                task = json.loads(line)
                show(task, *in_a_process(task))
            elif line.startswith("symmetries"):
                print(line, end="")
