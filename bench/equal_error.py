"""CPU time at the same true error, of anmech and of heyoka, in doubles: the motions of motion_problems.mac.

    equal_error.py < lines of equal_error.mac

The error of a motion is that of its end: the largest difference of a coordinate from the reference, in parts of the
largest coordinate there, or the same of the rates, whichever is larger.  (Coordinates are the first half of the states,
of five the first three.)  The reference has 25 digits, of anmech; heyoka, at its finest, has to agree.  Starts and ends
that are no doubles are rounded, for both.

Time at an error: the cheapest run that is no worse, and the next cheaper one, which is worse, are interpolated in
logarithms.  Of anmech that is the better one of its methods.  Where one of the three does not come to the error asked
for, in doubles, they are compared at the least that all of them reach: marked with a star."""
import math
import sys
from collections import defaultdict
from decimal import Decimal

import numpy as np

import motion

ASKED = 1e-9, 1e-12
TOLERANCES = [10.0**-k for k in range(5, 16)] + [2.0**-52]


def error_of(state, reference):
    half = (len(state) + 1)//2
    return max(float(max(abs(Decimal(float(a)) - b) for a, b in zip(state[part], reference[part])) /
                     max(map(abs, reference[part]))) for part in (slice(half), slice(half, None)))


def read(lines):
    """References, {name: [number, ...]}, and ladders, {name: {(one run or verified, method): [(error, ms), ...]}}."""
    references, ladders = {}, defaultdict(lambda: defaultdict(list))
    for line in lines:
        word, *rest = line.strip().split("; ")
        if word != "equal error":
            continue
        name, kind, *rest = rest
        if kind == "reference":
            references[name] = [Decimal(number.replace("b", "e")) for number in rest]
        else:
            ladders[name][kind, rest[0]].append((float(rest[1]), float(rest[2])))
    return references, ladders


def heyoka_ladder(problem, reference):
    """As tell_ladder of equal_error.mac; and the error of the finest tolerance."""
    (rates, states), start, end = problem
    ladder, least = [], 1e-6
    for tolerance in TOLERANCES:
        run = motion.taylor(rates, states, np.array(start, dtype=float), end, tolerance)
        error = error_of(run(), reference)
        if 1e-12 < least and error < least:
            least = error
            ladder.append((error, motion.milliseconds(run)))
    return ladder, error


def time_at(wanted, ladder):
    """Infinite if no run is so good."""
    worse = None
    for error, spent in sorted(ladder, key=lambda run: (run[1], run[0])):
        if error <= wanted:
            if worse is None or error == worse[0]:
                return spent
            part = math.log(worse[0]/wanted)/math.log(worse[0]/error)
            return worse[1]*(spent/worse[1])**part
        if worse is None or error < worse[0]:
            worse = error, spent
    return math.inf


def best(wanted, ladders, kind):
    """(ms, method)."""
    return min((time_at(wanted, ladder), method) for (k, method), ladder in ladders.items() if k == kind)


def least_of_all(ladders):
    """The least error that every kind of run reaches by one of its methods."""
    return max(min(error for (k, _), ladder in ladders.items() if k == kind for error, _ in ladder)
               for kind in {k for k, _ in ladders})


def tell(asked, ladders):
    ratios = {"one run": [], "verified": []}
    for name, runs in ladders.items():
        wanted = max(asked, least_of_all(runs))
        peer, _ = best(wanted, runs, "heyoka")
        line = "equal error: %-16s %.1e%s heyoka %8.3f" % (name, wanted, " " if wanted == asked else "*", peer)
        for kind, found in ratios.items():
            spent, method = best(wanted, runs, kind)
            found.append(spent/peer)
            line += "  %s %8.3f %s  ratio %5.2f" % (kind, spent, method, spent/peer)
        print(line)
    for kind, found in ratios.items():
        print("equal error: at %.0e, %s by heyoka: geometric mean %.2f, from %.2f to %.2f" %
              (asked, kind, math.exp(sum(map(math.log, found))/len(found)), min(found), max(found)), flush=True)


def main():
    references, ladders = read(sys.stdin)
    missing = set(motion.problems) - {name for name in references if len({kind for kind, _ in ladders[name]}) == 2}
    if missing:
        sys.exit("equal error: Maxima has not told of " + ", ".join(sorted(missing)))
    for name, problem in motion.problems.items():
        ladders[name]["heyoka", ""], finest = heyoka_ladder(problem, references[name])
        print("equal error: %-16s the reference and heyoka's finest run differ by %.1e" % (name, finest), flush=True)
        if finest > 1e-8:
            sys.exit("equal error: that is too much")
    for asked in ASKED:
        tell(asked, ladders)


main()
