;;; anmech: what cannot stand in a formula, and names that hold nothing of the user's.
;;;
;;; Entry points: $anmech_foreign_part, $anmech_is_assignable.

(in-package :anmech)
(needs "session/scope" "session/structures")

(maxima::defmfun maxima::$anmech_foreign_part (form)
  "anmech_foreign_part(expr): a text or a structure, such as a system, that stands in it at any depth; false if there
is none."
  (cond ((or (stringp form) (shape-of form)) form)
        ((atom form) nil)
        ((operator-p form 'maxima::mrat) (maxima::$anmech_foreign_part (maxima::$ratdisrep form)))
        (t (some #'maxima::$anmech_foreign_part (rest form)))))

(maxima::defmfun maxima::$anmech_is_assignable (name)
  "anmech_is_assignable(name): whether Maxima lets a symbol have any value; those like values and all have one that is
Maxima's."
  (not (get name 'maxima::assign)))
