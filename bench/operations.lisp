;;; How many operations expressions take once common subexpressions are shared, as a Maxima function for measurements.

(in-package :anmech)

(maxima::defmfun maxima::$operations (expressions)
  "operations([expr, ...])"
  (operation-count (rest expressions)))
