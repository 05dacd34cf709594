;;;; projection.lisp: what rtest_projection.mac asks.
;;;;
;;;;   with_doubles_kept(count, expr)    the value of expr, where an integration keeps about so many numbers of its
;;;;                                     steps, and takes the others again

(in-package :anmech)

(load-kernel "numerics/integration")

(maxima::defmspec maxima::$with_doubles_kept (form)
  (let ((*most-doubles* (maxima::meval (second form))))
    (maxima::meval (third form))))
