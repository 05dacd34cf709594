;;; anmech: motions, and what they are asked by.
;;;
;;; A *task* is all that a user has said of a motion, in numbers; a method makes a *motion* of it.  How motions are read
;;; is told in motion_reading.lisp.
;;;
;;; Entry points: the structures TASK and MOTION; NEW-TASK, TASK-OPTION, TASK-OTHER-START, CHECK-CONSTANTS;
;;; MOTION-DIMENSION, START-TIME, STATE-AT; SENTENCES.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats" "numerics/dag" "numerics/doubles" "numerics/integration" "numerics/model"
       "numerics/projection")

;;; Tasks

(defstruct (task (:print-function print-dots))
  problem        ; in doubles: the nearest ones
  exact          ; the exact states, time and parameters at the beginning, a list: for methods of other precision
  exact-end      ; the exact last time
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
    (let* ((exact (mapcar #'exact-value (append states (list (first interval)) parameters)))
           (exact-end (exact-value (second interval)))
           (problem (make-problem :model model :field (model-field model) :n (length states)
                                  :timed (model-timed-p model)
                                  :patience (if (option 'maxima::$max_steps)
                                                most-positive-fixnum
                                                (patient-steps model))
                                  :start (doubles (mapcar #'to-double exact)) :end (to-double exact-end))))
      (when (option 'maxima::$projection)
        (setf (problem-projection problem)
              (projection-at (problem-start problem) (option 'maxima::$projection) problem)))
      (make-task :problem problem
                 :exact exact :exact-end exact-end :prepared prepared :options options
                 :accuracy (to-double (exact-value (option 'maxima::$accuracy)))
                 :verify (option 'maxima::$verify)
                 :max-steps (option 'maxima::$max_steps)
                 :progress progress))))

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

(defun task-other-start (task)
  "The start with every number that is no double rounded to the other side; but at one and the same time."
  (let* ((problem (task-problem task)) (n (problem-n problem)) (start (problem-start problem))
         (other (map 'double-array #'neighbour start (task-exact task))))
    (setf (aref other n) (aref start n))
    other))

;;; Motions

(defstruct (motion (:print-function print-dots))
  model
  integration                       ; of the kernel, with dense output
  start                             ; double array: first states, time, parameters
  reached                           ; the time up to which it is given
  error-estimate                    ; nil if not verified
  (evaluations 0) (seconds 0d0)     ; of all integrations together
  (compile-seconds 0d0)             ; 0 if another motion has made use of the code before
  message                           ; why it is not what was asked for; nil if it is
  (facts '()))                      ; what the layer above notes: pairs (name . value)

(defun sentences (&rest parts)
  "Those of PARTS that are not nil, as one."
  (let ((said (remove nil parts))) (and said (coerce (format nil "~{~a~^; ~}" said) 'simple-string))))

(defun motion-dimension (motion) (model-dimension (motion-model motion)))
(defun start-time (motion) (aref (motion-start motion) (motion-dimension motion)))

(defun state-at (motion time in)
  "Write state, time and parameters at TIME to IN."
  (replace in (motion-start motion))
  (dense-value (motion-integration motion) time in)
  (setf (aref in (motion-dimension motion)) time)
  in)
