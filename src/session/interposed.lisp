;;; anmech: functions of Maxima's that do something else while a verb works.
;;;
;;; Each is replaced once, by one that looks at a special variable: to set a function, as often as a verb is called,
;;; would take some Lisps longer than all else around a short call.
;;;
;;; Entry points: INTERPOSE; *ANSWERING*, *OPTION-TEST*.

(in-package :anmech)
(needs)

(defvar *answering* nil "The function that answers Maxima's questions instead of the user; nil: the user does.")
(defvar *option-test* nil "The function that tells Maxima whether a variable is an option; nil: its own.")

(defun interpose (name variable)
  "From now on the function NAME does what the one in VARIABLE does, if there is one there; otherwise what it did, also
where somebody has replaced it since."
  (let ((own (symbol-function name)))
    (unless (eq own (get name 'interposed))
      (setf (get name 'interposed) (lambda (&rest arguments) (apply (or (symbol-value variable) own) arguments))
            (symbol-function name) (get name 'interposed)))))
