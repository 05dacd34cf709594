;;; anmech: work that is given up when it takes too long, or when the user interrupts it.
;;;
;;; Lisp gives no alarm that all three systems have, so long loops of the kernel ask whether there is time left (POLL).
;;; What Maxima itself does in one go (factor, integrate) is not stopped.
;;;
;;; Entry points: anmech_within; POLL.

(in-package :anmech)
(needs "session/outcomes")

(defvar *deadline* nil "The internal real time at which the innermost work in hand is given up; nil: never.")
(defvar *deadline-tag* nil "Where that goes on.")
(defvar *interruption-tag* nil "Where what is in hand goes on when the user interrupts it.")

(declaim (inline poll))
(defun poll ()
  "To be called now and then by what may take long."
  (when (and *deadline* (> (get-internal-real-time) (the integer *deadline*)))
    (throw *deadline-tag* :late)))

(defun call-within (seconds thunk)
  "The value of THUNK, or :late, or :interrupted.  A nearer deadline further out holds."
  (let* ((own (+ (get-internal-real-time) (ceiling (* seconds internal-time-units-per-second))))
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
                              (when (and *interruption-tag*
                                         (typep condition '(or serious-condition #+ecl ext:interactive-interrupt))
                                         (interruption-p condition))
                                (throw *interruption-tag* :interrupted)))))
    (funcall thunk)))

(maxima::defmspec maxima::$anmech_within (form)
  "anmech_within(seconds, expr): the value of expr; not found, because late or interrupted."
  (let ((value (call-within (maxima::meval (second form)) (lambda () (maxima::meval (third form))))))
    (case value
      (:late (maxima::$anmech_not_found 'maxima::$late))
      (:interrupted (maxima::$anmech_not_found 'maxima::$interrupted))
      (t value))))
