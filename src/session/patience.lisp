;;; anmech: work that is given up when it takes too long, or when the user interrupts it.
;;;
;;; Lisp gives no alarm that all three systems have, so long loops of the kernel ask whether there is time left (POLL).
;;; It is the time of this process that counts: what is found must not depend on what else the machine does.
;;; What Maxima itself does in one go (factor, integrate) is not stopped.
;;;
;;; Control-C (the signal SIGINT, which front ends send, too) ends the verb at work, with an error.  Who has found
;;; something by then may keep it, in one of two ways.  A loop of numbers lets an interruption be noted only, and asks
;;; for it where it can stop.  A search gives up the part that it was at, and goes on from there to its end: it sees
;;; that it has been interrupted, and says so; if nobody says it, the verb ends with the error after all.
;;; A second interruption is never kept.
;;;
;;; Entry points: anmech_within, CALL-WITHIN, POLL; CALL-NOTING-INTERRUPTIONS, INTERRUPTED-P, NOTE-INTERRUPTION,
;;; *WHEN-NOTED*; anmech_until_interrupted, anmech_is_interrupted, anmech_tell_interruption; for the guard
;;; CALL-UNTIL-INTERRUPTED, CALL-INTERRUPTIBLY and *INTERRUPTION*.

(in-package :anmech)
(needs "session/outcomes" "session/prepared_code")

(defvar *deadline* nil "The internal run time at which the innermost work in hand is given up; nil: never.")
(defvar *deadline-tag* nil "Where that goes on.")
(defvar *interruption-tag* nil "Where what is in hand goes on when the user interrupts it.")

(defvar *interruption* nil "Of the verb at work: nil, :untold, or :told, once its user knows that it was interrupted.")
(defvar *when-noted* nil "A function that is called when an interruption is noted; nil: nothing is done.")
(defvar *note* nil "Where interruptions are noted only: a cons, of the condition that has been noted; nil: nowhere.")

(declaim (inline poll))
(defun poll ()
  "To be called now and then by what may take long."
  (when (and *deadline* (> (values (get-internal-run-time)) (the integer *deadline*)))
    (throw *deadline-tag* :late)))

(defun call-within (seconds thunk)
  "The value of THUNK, or :late, or :interrupted.  A nearer deadline further out holds."
  (let* ((own (+ (values (get-internal-run-time)) (ceiling (* seconds internal-time-units-per-second))))
         (nearer (and *deadline* (<= *deadline* own)))
         (tag (if nearer *deadline-tag* (list :deadline)))
         (*deadline-tag* tag)
         (*deadline* (if nearer *deadline* own)))
    (call-until-interrupted (lambda () (if nearer (funcall thunk) (catch tag (funcall thunk)))))))

(defun interruption-p (condition)
  "Whether the user has typed Control-C: on GCL that is an error like others, but for its text."
  (or #+sbcl (typep condition 'sb-sys:interactive-interrupt)
      #+ecl (typep condition 'ext:interactive-interrupt)
      #-(or sbcl ecl) (search "Console interrupt" (princ-to-string condition))))

(defun call-until-interrupted (thunk)
  "The value of THUNK, or :interrupted."
  (let ((*interruption-tag* (list :interruption)))
    (catch *interruption-tag* (call-interruptibly thunk))))

(defun call-interruptibly (thunk)
  "The value of THUNK; what catches errors outside of this does not take an interruption for one."
  (handler-bind ((condition (lambda (condition)
                              (when (and (typep condition '(or serious-condition #+ecl ext:interactive-interrupt))
                                         (interruption-p condition))
                                (take-interruption condition)))))
    (funcall thunk)))

(defun take-interruption (condition)
  (when (and *note* (null (car *note*)))
    (setf (car *note*) condition)
    (when *when-noted* (funcall *when-noted*))
    ;; SBCL first asks all who handle conditions, and can be told to go on only where it would enter its debugger
    #-sbcl (invoke-restart (find-restart 'continue condition)))
  (when (and *interruption-tag* (not (and *note* (eq condition (car *note*)))))
    (throw *interruption-tag* :interrupted)))

(defun call-noting-interruptions (thunk)
  "The values of THUNK, in which the first interruption does nothing but make INTERRUPTED-P true.  THUNK tells the user;
whoever has called for many such values asks anmech_is_interrupted whether to go on."
  (let ((*note* (list nil)))
    (multiple-value-prog1 (call-noted thunk)
      (when (and (car *note*) (null *interruption*)) (setq *interruption* :told)))))

(defun call-noted (thunk)
  #+sbcl
  (let* ((outer sb-ext:*invoke-debugger-hook*)
         (sb-ext:*invoke-debugger-hook* (lambda (condition hook)
                                          (if (eq condition (car *note*))
                                              (invoke-restart 'continue)
                                              (when outer (funcall outer condition hook))))))
    (call-interruptibly thunk))
  #-sbcl
  (call-interruptibly thunk))

(defun note-interruption ()
  "To be called where another program that the session was waiting for has met with one in its place."
  (when (and *note* (null (car *note*))) (setf (car *note*) t)))

(declaim (inline interrupted-p))
(defun interrupted-p ()
  "Whether an interruption has been noted."
  (and *note* (car *note*) t))

(maxima::defmspec maxima::$anmech_until_interrupted (form)
  "anmech_until_interrupted(expr, otherwise): the value of expr; where it is interrupted, or the verb was before, that
of otherwise."
  (let ((value (if *interruption*
                   :interrupted
                   (call-until-interrupted (lambda () (maxima::meval (second form)))))))
    (cond ((eq value :interrupted)
           (unless *interruption* (setq *interruption* :untold))
           (maxima::meval (third form)))
          (t value))))

(maxima::defmfun maxima::$anmech_is_interrupted ()
  "anmech_is_interrupted(): whether the verb at work has been, and is coming to its end."
  (and *interruption* t))

(maxima::defmfun maxima::$anmech_tell_interruption ()
  "anmech_tell_interruption(): to be called by who tells the user; whether there is something to tell."
  (and *interruption* (setq *interruption* :told) t))

(maxima::defmspec maxima::$anmech_within (form)
  "anmech_within(seconds, expr): the value of expr; not found, because late or interrupted."
  (let ((value (call-within (maxima::meval (second form)) (lambda () (maxima::meval (third form))))))
    (case value
      (:late (maxima::$anmech_not_found 'maxima::$late))
      (:interrupted (maxima::$anmech_not_found 'maxima::$interrupted))
      (t value))))

(define-handed-on maxima::$anmech_until_interrupted maxima::$anmech_within)
