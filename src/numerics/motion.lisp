;;; anmech: motions, and what they are asked by.
;;;
;;; A *task* is all that a user has said of a motion, in numbers; a method makes a *motion* of it.  How motions are read
;;; is told in motion_reading.lisp.
;;;
;;; Entry points: the structures TASK, MOTION and LONG-RECORD; NEW-TASK, TASK-BEGUN, WITH-BREAKPOINTS, TASK-OPTION,
;;; TASK-EXACT, TASK-OTHER-START, CHECK-CONSTANTS; MOTION-DIMENSION, STATUS-OF-MOTION, START-TIME, STATE-AT, SIDES-OF;
;;; HOLDS-UNKNOWNS-P, WITH-UNKNOWNS; SENTENCES.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats" "numerics/doubles" "numerics/evaluation" "numerics/integration"
       "numerics/model" "numerics/projection" "numerics/surfaces")

;;; Tasks

(defstruct (task (:print-function print-dots))
  problem        ; in doubles: the nearest ones
  given          ; the states, time and parameters at the beginning as they were given, a list
  given-end      ; the last time, too
  prepared       ; what the method's module has derived from the system
  options        ; an alist of all options, those of the method too, as far as they were given
  accuracy verify
  max-steps      ; nil: as many as the method thinks fit
  progress)      ; nil, or a function (what part)

(defun task-option (task name)
  "The value of an option; nil if it was not given."
  (cdr (assoc name (task-options task))))

(defun new-task (model prepared states interval parameters options progress)
  "STATES, INTERVAL and PARAMETERS are lists of numbers of Maxima, OPTIONS an alist."
  (flet ((option (name) (cdr (assoc name options))))
    (task-begun (make-task :problem (new-problem model (first interval) (second interval) options)
                           :given-end (second interval)
                           :prepared prepared :options options
                           :accuracy (maxima::$anmech_double (option 'maxima::$accuracy))
                           :verify (option 'maxima::$verify)
                           :max-steps (let ((most (option 'maxima::$max_steps)))
                                        (and most (min most most-positive-fixnum)))
                           :progress progress)
                (append states (list (first interval)) parameters))))

(defun task-begun (task given)
  "TASK, at the beginning of which states, time, always the same, and parameters are GIVEN; with the fields that the
model has now: after many motions it is compiled anew (HASTEN-FIELD)."
  (let* ((task (copy-task task)) (problem (copy-problem (task-problem task))) (model (problem-model problem)))
    (setf (problem-start problem) (start-of-problem model given)
          (problem-field problem) (model-field model)
          (problem-smooth-field problem) (and (problem-surfaces problem) (model-smooth-field model))
          (task-problem task) problem
          (task-given task) given)
    (when (task-option task 'maxima::$projection)
      (setf (problem-projection problem)
            (projection-at (problem-start problem) (task-option task 'maxima::$projection) problem)))
    task))

(defun task-exact (task)
  "The exact states, time and parameters at the beginning, a list: for methods of other precision."
  (mapcar #'exact-value (task-given task)))

(defun projection-at (start projection problem)
  "PROJECTION with the values that its functions have at START; what is not constant there is an error."
  (handler-case
      (progn (check-constant projection problem start)
             (settled-projection projection start (problem-n problem)))
    ((or domain-violation arithmetic-error) (condition)
      (complain "project: ~a" condition))))

(defun check-constant (projection problem in)
  (let* ((n (problem-n problem)) (name (wandering projection (problem-field problem) in n)))
    (when name
      (complain "project: ~a is not constant along the motion, see time ~a" name (maxima-text (aref in n))))))

(defun check-constants (motion task)
  "Complain of what the steps of MOTION were projected onto and is not constant."
  (let* ((problem (task-problem task)) (projection (problem-projection problem))
         (way (- (motion-reached motion) (start-time motion))))
    (when projection
      (handler-case
          (loop for k from 1 to 12
                do (check-constant projection problem (state-at motion (+ (start-time motion) (* way (/ k 12)))
                                                                (copy-seq (motion-start motion)))))
        ((or domain-violation arithmetic-error) () nil)))))

(defparameter *patient-work* 2d9 "Operations of doubles: about ten seconds.")

(defun patient-steps (model)
  "How many steps of a motion that has become stiff are worth taking, if its user says nothing."
  (floor *patient-work* (* 12 (+ (model-work model) (* 12 (model-dimension model))))))

(defun start-of-problem (model given)
  "Like the input of the field, from the numbers that are GIVEN of states, time and parameters."
  (let* ((surfaces (model-surfaces model)) (start (zeros (+ (length given) (length (side-inputs surfaces))))) (place 0))
    (declare (type double-array start) (fixnum place))
    (dolist (number given)
      (setf (aref start place) (the double-float (if (floatp number) number (maxima::$anmech_double number))))
      (incf place))
    (if surfaces (put-signs surfaces start) start)))

(defun new-problem (model t0 end options)
  "One that has still to be told where it begins, and by which fields (TASK-BEGUN)."
  (flet ((option (name) (cdr (assoc name options)))
         (number (number) (maxima::$anmech_double number)))
    (let ((end (number end)))
      (make-problem :model model :n (model-dimension model) :timed (model-timed-p model)
                    :patience (if (option 'maxima::$max_steps) most-positive-fixnum (patient-steps model))
                    :surfaces (model-surfaces model) :start (zeros 0) :end end
                    :events (events-of model (rest (option 'maxima::$events)))
                    :breakpoints (times-between (mapcar #'number (rest (option 'maxima::$breakpoints)))
                                                (number t0) end)
                    :longest (and (option 'maxima::$max_step) (number (option 'maxima::$max_step)))))))

(defun with-breakpoints (problem times)
  "PROBLEM, with TIMES among its breakpoints."
  (let ((other (copy-problem problem)))
    (setf (problem-breakpoints other)
          (times-between (append times (problem-breakpoints problem)) (problem-time problem) (problem-end problem)))
    other))

(defun times-between (times start end)
  "Those of TIMES that are between START and END, in that order, each once."
  (loop for (time . later) on (sort (remove-if-not (lambda (time) (< (min start end) time (max start end))) times)
                                    (if (< start end) #'< #'>))
        unless (eql time (first later)) collect time))

(defun events-of (model events)
  "The structures of EVENTS, lists [expr, direction, terminal, name] of Maxima."
  (loop for (nil expression direction terminal name) in events
        for number from 1
        collect (make-event :number number :name name :direction direction :terminal terminal
                            :function (function-of-point model expression))))

(defun holds-unknowns-p (model expressions)
  "Whether one of the unknowns of A u = b occurs in EXPRESSIONS."
  (some (lambda (unknown)
          (notevery (lambda (expression) (maxima::$freeof unknown expression)) expressions))
        (model-unknowns model)))

(defun with-unknowns (model in)
  "IN, followed by the unknowns there."
  (let ((unknowns (zeros (length (model-unknowns model)))))
    (funcall (the function (model-solver model)) in unknowns)
    (concatenate 'double-array in unknowns)))

(defun function-of-point (model expression)
  "The value of EXPRESSION at an array like the input of the field."
  (let* ((inner (holds-unknowns-p model (list expression)))
         (function (expressions-function (list expression)
                                         (append (model-inputs model) (and inner (model-unknowns model))))))
    (lambda (point) (first (funcall (the function function) (if inner (with-unknowns model point) point))))))

(defun task-other-start (task)
  "The start with every number that is no double rounded to the other side; but at one and the same time."
  (let* ((problem (task-problem task)) (n (problem-n problem)) (start (problem-start problem))
         (other (copy-seq start)))
    (loop for exact in (task-exact task)
          for place from 0
          unless (or (= place n) (double-p exact))
            do (setf (aref other place) (neighbour (aref start place) exact)))
    other))

;;; Motions

(defstruct (motion (:print-function print-dots))
  model
  integration                       ; of the kernel, with dense output
  start                             ; double array: first states, time, parameters, sides
  reached                           ; the time up to which it is given
  error-estimate                    ; nil if not verified
  (unverified nil)                  ; whether nobody wanted to know it
  (evaluations 0) (seconds 0d0)     ; of all integrations together
  (compile-seconds 0d0)             ; 0 if another motion has made use of the code before
  message                           ; why it is not what was asked for; nil if it is
  (long nil)                        ; LONG-RECORD, if it has more digits than doubles
  (enclosure nil)                   ; ENCLOSURE of lohner.lisp, if its bounds are proved
  (facts '()))                      ; what the layer above notes: pairs (name . value)

(defstruct (long-record (:print-function print-dots))
  integration                       ; of long_integration.lisp
  inputs                            ; exact states, time, parameters at the beginning: a vector
  digits reached)

(defun sentences (&rest parts)
  "Those of PARTS that are not nil, as one."
  (let ((said (remove nil parts))) (and said (coerce (format nil "~{~a~^; ~}" said) 'simple-string))))

(defun status-of-motion (motion)
  (cond ((motion-unverified motion)
         (sentences "not verified: nothing is known of the error" (motion-message motion)))
        ((motion-message motion) (sentences (motion-message motion)))
        ((motion-enclosure motion) 'maxima::$proved)
        (t 'maxima::$complete)))

(defun motion-dimension (motion) (model-dimension (motion-model motion)))
(defun start-time (motion) (aref (motion-start motion) (motion-dimension motion)))

(defun state-at (motion time in)
  "Write state, time, parameters and sides at TIME to IN."
  (replace in (motion-start motion))
  (dense-value (motion-integration motion) time in)
  (setf (aref in (motion-dimension motion)) time)
  (let ((sides (sides-of motion)))
    (when sides (funcall (the function sides) in)))
  in)

(defun sides-of (motion)
  "A function that notes in a point like the input of the field the sides of surfaces there; nil if there are none."
  (let ((surfaces (model-surfaces (motion-model motion))))
    (or (integration-sides (motion-integration motion))
        (and surfaces (lambda (point) (put-signs surfaces point))))))
