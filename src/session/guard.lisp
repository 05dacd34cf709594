;;; anmech: the guard under which every verb runs.
;;;
;;; A fresh context, Maxima's options at their defaults, no interactive question, every error one sentence that begins
;;; with the name of the verb; and all as it was at the end.
;;;
;;; Entry points: WITH-GUARD, TEXT-OF-ERROR; *FACT-READERS*.

(in-package :anmech)
(needs "session/contexts" "session/interposed" "session/memory" "session/patience" "session/scope" "session/texts")

;;; The guard

(defparameter *kept-variables*
  '(maxima::$multiplicities maxima::$%rnum maxima::$%rnum_list maxima::$gensumnum
    maxima::$integration_constant_counter)
  "Variables that Maxima's own functions change on the way; they are as before at the end.")

(defvar *fact-readers* '() "Functions that are told what the user has assumed, when a verb begins.")

(defun no-question (message flag &rest more)
  (declare (ignore flag more))
  (let ((text (string-trim '(#\Space #\Newline)
                           (format nil "~{~a~}"
                                   (mapcar (lambda (part)
                                             (if (stringp part) part (one-line (funcall *outer-form* part))))
                                           (if (consp message) (rest message) (list message)))))))
    (complain "\"~a\" cannot be decided; say so with assume(...) first" text)))

(defun with-guard (verb thunk)
  "Call THUNK as the body of VERB; every error comes out as one sentence that begins with the name of VERB."
  (let ((problem nil) (last-error maxima::$error) (*interruption* nil))
    (let ((value (block attempt
                   (if maxima::*mdebug*
                       (call-guarded verb thunk)
                       (handler-case
                           (let ((value (call-until-interrupted
                                         (lambda ()
                                           (with-maxima-errors
                                             (maxima::rat-error-to-merror (call-guarded verb thunk)))))))
                             (when (or (eq value :interrupted) (eq *interruption* :untold))
                               (setq problem (format nil "~a: interrupted" (plain-name verb))))
                             value)
                         (maxima::maxima-$error () (setq problem (error-sentence verb)))
                         (storage-condition ()
                           (setq problem (format nil "~a: internal error: a recursion of Maxima does not end"
                                                 (plain-name verb))))
                         (error (condition)
                           (setq problem (format nil "~a: internal error: ~a" (plain-name verb) condition))))))))
      (when problem (maxima::merror "~A" problem))
      (setq maxima::$error last-error)          ; errors inside that the verb knew what to do with
      value)))

(defun text-of-error ()
  "Maxima's last error, without the name of the verb."
  (let* ((maxima::$display2d nil)
         (text (string-trim '(#\Space #\Newline)
                            (apply #'maxima::aformat nil (second maxima::$error) (cddr maxima::$error))))
         (name (and *verb* (format nil "~a: " (plain-name *verb*)))))
    (coerce (if (eql 0 (and name (search name text))) (subseq text (length name)) text) 'simple-string)))

(defun error-sentence (verb)
  "Maxima's last error, as text that begins with the name of VERB."
  (let* ((text (text-of-error)) (name (plain-name verb)))
    (if (eql 0 (search name text)) text (format nil "~a: ~a" name text))))

(defun active-facts ()
  "What the user has assumed: in the present context, in those that it rests on, and in those activated."
  (maxima::contextmark)
  (loop for context in (rest maxima::$contexts)
        when (plusp (or (get context 'maxima::cmark) 0))
          append (rest (maxima::$facts context))))

(defun set-where-other (variable value)
  "Most options stand at their defaults, and setting a variable costs a Lisp ten times what reading it does."
  (unless (and (boundp variable) (eq (symbol-value variable) value))
    (set variable value)))

(defun call-guarded (verb thunk)
  "While THUNK works, Maxima does not enter local variables in the lists of variables and of options that the user has
assigned to: that would take a seventh of the time."
  (let* ((*verb* verb)
         (maxima::dsksetp t)
         (maxima::$setcheck nil)
         (maxima::$optionset nil)
         (maxima::$myoptions (copy-list maxima::$myoptions))
         (*answering* #'no-question)
         (*option-test* (constantly nil))
         (variables (remove-if-not #'boundp (append *kept-variables* (mapcar #'first *plain-options*))))
         (before (mapcar #'symbol-value variables))
         (facts (active-facts)))
    (interpose 'maxima::retrieve '*answering*)
    (interpose 'maxima::optionp '*option-test*)
    (with-own-context
      (unwind-protect
           (progn (loop for (option value) in *plain-options* do (set-where-other option value))
                  (setq facts (forget-under-other facts))
                  (when facts (dolist (reader *fact-readers*) (funcall reader facts)))
                  (funcall thunk))
        (mapc #'set-where-other variables before)))))
