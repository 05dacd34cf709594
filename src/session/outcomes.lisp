;;; anmech: what came of looking for something, in one vocabulary.
;;;
;;;   none        there is none, and that is proved
;;;   not found   it was looked for, and not found because of a reason: a word, and what belongs to it
;;;   undecided   nothing is known
;;;
;;; These are objects that no user can have typed, so none of them can be mistaken for an expression.  Sentences are
;;; made of them where they are shown.
;;;
;;; Entry points: anmech_none, anmech_not_found, anmech_undecided; anmech_found, anmech_is_none, anmech_is_undecided,
;;; anmech_reason; anmech_sentences, anmech_sentence.

(in-package :anmech)
(needs "session/scope" "session/texts")

(maxima::defmfun maxima::$anmech_none ()
  "anmech_none(): there is none."
  'maxima::|$none`|)

(maxima::defmfun maxima::$anmech_undecided ()
  "anmech_undecided(): nothing is known."
  'maxima::|$undecided`|)

(maxima::defmfun maxima::$anmech_not_found (reason &rest details)
  "anmech_not_found('reason, ...): it was not found, because."
  (list* '(maxima::|$not_found`| maxima::simp) reason details))

(defun not-found-p (form) (operator-p form 'maxima::|$not_found`|))

(maxima::defmfun maxima::$anmech_found (form)
  "anmech_found(x): whether x is something, and none of these.  Truth values are no outcomes: who asks this of one has
called something that speaks another dialect."
  (when (member form '(nil t)) (error "a truth value is taken for an outcome"))
  (not (or (member form '(maxima::|$none`| maxima::|$undecided`|)) (not-found-p form))))

(maxima::defmfun maxima::$anmech_is_none (form)
  "anmech_is_none(x): whether it is proved that there is none."
  (eq form 'maxima::|$none`|))

(maxima::defmfun maxima::$anmech_is_undecided (form)
  "anmech_is_undecided(x)"
  (eq form 'maxima::|$undecided`|))

(maxima::defmfun maxima::$anmech_reason (form)
  "anmech_reason(x): [reason, ...] of what was not found; [] for anything else."
  (cons '(maxima::mlist maxima::simp) (and (not-found-p form) (rest form))))

(defvar *sentences* (make-hash-table :test #'eq) "From a reason to its text.")

(maxima::defmspec maxima::$anmech_sentences (form)
  "anmech_sentences(reason = text, ...): how reasons are told; ~a in a text stands for what belongs to the reason."
  (dolist (equation (rest form) 'maxima::$done)
    (setf (gethash (second equation) *sentences*) (maxima::meval (third equation)))))

(maxima::defmfun maxima::$anmech_sentence (form)
  "anmech_sentence(x): why x was not found."
  (destructuring-bind (reason . details) (rest form)
    (apply #'format nil (gethash reason *sentences*)
           (mapcar (lambda (detail)
                     (if (stringp detail) detail (one-line (funcall *outer-form* detail) most-positive-fixnum)))
                   details))))
