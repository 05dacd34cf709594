;;; anmech: what names were declared to depend on.
;;;
;;; Maxima's list  dependencies  holds calls, beta(t), and whatever looks at one of them simplifies it: of a name that
;;; is also a function of Maxima's, that ends in an error about its arguments.
;;;
;;; Entry point: anmech_declared_dependencies.

(in-package :anmech)

(maxima::defmfun maxima::$anmech_declared_dependencies (name)
  "anmech_declared_dependencies(x): the list of what x was declared to depend on."
  (cons '(maxima::mlist maxima::simp) (copy-list (maxima::mget name 'maxima::depends))))
