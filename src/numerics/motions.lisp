;;; anmech: many motions of one system, which differ in some numbers.
;;;
;;; The model is compiled once, and of each motion only what is asked for is kept: the values of some expressions where
;;; it ends, its estimate of the error and its status.  All is computed as for a single motion, so the numbers are the
;;; same to the last bit.  What is wrong with one of them is its status, and does not keep the others; so is an
;;; interruption.
;;;
;;; Entry points: $anmech_many_motions, $anmech_row_of_other_length; *NOT-BEGUN*.

(in-package :anmech)
(needs "session/guard" "session/patience" "session/structures" "session/texts" "arithmetic/floats" "algebra/terms"
       "numerics/dag" "numerics/dependent_values" "numerics/doubles" "numerics/enclosed_motion"
       "numerics/integration" "numerics/long_motion" "numerics/methods" "numerics/model" "numerics/motion"
       "numerics/motion_reading" "numerics/progress" "numerics/registers")

(defun more-than-doubles-p (options)
  (or (long-digits options) (rigorous-p options)))

(defun quick-form (number options)
  "NUMBER, which may be irrational, as a number that takes no time to be converted; itself where OPTIONS ask for more
than doubles, to which it is rounded then."
  (if (or (floatp number) (more-than-doubles-p options))
      number
      (from-rational (exact-value number))))

(defun trouble-with-numbers (row names)
  (loop for number in row
        for name in names
        unless (maxima::$anmech_double number)
          do (return (format nil "expected a number as value of ~a, found ~a" (one-line name) (one-line number)))))

(defun trouble-with-start (start check names)
  "What is wrong with a start, whose numbers are in START, by CHECK: nil, or registers that compute constraints, and the
sizes of their terms.  NAMES are texts of the constraints."
  (when check
    (replace (registers-numbers check) (the double-array start) :end1 (registers-inputs check))
    (handler-case (run-registers check)
      ((or domain-violation arithmetic-error) (condition)
        (return-from trouble-with-start (format nil "~a" condition))))
    (let* ((found (result-list check)) (worst 0d0) (text nil))
      (loop for name in names
            for value in found
            for size in (nthcdr (length names) found)
            do (unless (zerop size)
                 (when (> (/ (abs value) size) (max worst 1d-9))
                   (setq worst (/ (abs value) size)
                         text (format nil "the initial values violate the constraint ~a = 0: its left side is ~a" name
                                      (maxima-text value))))))
      text)))

(defparameter *not-begun* "interrupted before it began")

(defun values-at-end (motion reader)
  "The list of them; :none where one has no value."
  (handler-case
      (if (motion-long motion)
          (long-values-at-end motion reader)
          (progn (funcall (the function (reading motion reader)) (float (motion-reached motion) 1d0))
                 (result-list (value-reader-registers reader))))
    ((or domain-violation arithmetic-error) () :none)))

(defun only-end-matters-p (task kept)
  "Whether nobody reads the way of a motion: KEPT are functions of it."
  (not (or kept (task-verify task) (problem-timed (task-problem task)) (problem-projection (task-problem task)))))

(defparameter *seconds-of-block* 0.5d0 "What motions that are made together may take: between, interruptions count.")
(defparameter *seconds-to-begin* 0.03d0 "What a block takes, however short it is.")
(defparameter *first-block* 64 "As long as nothing is known of how long motions take.")
(defparameter *largest-block* 20000)
(defparameter *growth-of-blocks* 64 "A block may be so much larger than one whose time is known.")

(defun size-of-block (pace way)
  "How many motions that are so long on their WAY are to be made together, by PACE, the slot of a model."
  (if pace
      (destructuring-bind (seconds . length) pace
        (max 1 (floor (min *largest-block* (* *growth-of-blocks* length) (/ *seconds-of-block* (* way seconds))))))
      *first-block*))

(defun map-in-blocks (function list model interval)
  "FUNCTION of blocks of LIST, motions of MODEL in INTERVAL."
  (destructuring-bind (start end) (mapcar #'maxima::$anmech_double interval)
    (loop with way = (min 1d200 (max 1d-200 (abs (- end start))))
          while list
          do (let* ((clock (get-internal-real-time)) (size (size-of-block (model-pace model) way))
                    (block (loop repeat size while list collect (pop list))))
               (funcall function block)
               (unless (interrupted-p)
                 (setf (model-pace model)
                       (cons (/ (max 1d-9 (- (seconds-since clock) *seconds-to-begin*)) (length block) way)
                             (length block))))))))

(defun motions-of-block (tasks integrator kept)
  "The motions of TASKS that can be made together: a list, nil of the others; nil if they are made one by one."
  (let ((together (and tasks (motions-together integrator (first tasks) kept))))
    (and together (funcall (the function together) tasks))))

(maxima::defmfun maxima::$anmech_row_of_other_length (rows length)
  "anmech_row_of_other_length([[number, ...], ...], length): the place of the first one; 0 if there is none."
  ;; not by  position,  which on GCL looks for each element of a list from its beginning
  (or (loop for row in (rest rows)
            for place from 1
            unless (= (length (rest row)) length) return place)
      0))

(maxima::defmfun maxima::$anmech_many_motions (name model prepared numbers places dependent varied rows interval
                                               options reader kept check constraints)
  "anmech_many_motions(method, model, prepared, [number, ...], [place, ...], dependent values, [name, ...],
[[number, ...], ...], [t0, t1], [option = value, ...], reader, [f, ...], check, [text, ...]): for the NUMBERS, of states
and then of parameters, with those of each row in their places, and those that depend on these, lists of the values that
the reader gives where the motion ends, of these times, of the estimates of the error, of what is to be said, and a list
of such lists of what the functions f give of the motion.  CHECK: false, or what is computed of constraints; or a
function of states and parameters that gives states that satisfy them."
  (let* ((options (given-options options))
         (progress (assoc 'maxima::$progress options))
         (line (progress-line (if progress (cdr progress) 'maxima::$auto) "integrate_motions"))
         (integrator (integrator-named name)) (n (model-dimension model))
         (numbers (mapcar (lambda (number) (and number (quick-form number options))) (rest numbers)))
         (places (mapcar #'1- (rest places))) (pattern nil)
         (exactly (more-than-doubles-p options)) (corrector (and check (not (registers-p check))))
         (interval (mapcar (lambda (time) (quick-form time options)) (rest interval)))
         (nothing (maxima-list (make-list (length (registers-results (value-reader-registers reader)))
                                          :initial-element 'maxima::$unknown)))
         (count (length (rest rows))) (done 0)
         (all '()) (ends '()) (errors '()) (statuses '()) (kept-lists (mapcar (constantly '()) (rest kept))))
    (labels ((note (found end error status &optional (facts (mapcar (constantly (maxima-list '())) (rest kept))))
               (push found all) (push end ends) (push error errors)
               (push (if (stringp status) (coerce status 'simple-string) status) statuses)     ; so it equals one read
               (setq kept-lists (mapcar #'cons facts kept-lists)))
             (note-trouble (sentence) (note nothing 'maxima::$unknown 'maxima::$unknown sentence))
             (begin-pattern (states parameters)
               (setq pattern (new-task model prepared states interval parameters options nil))
               (setf (problem-frugal (task-problem pattern)) (only-end-matters-p pattern (rest kept))))
             (task (numbers)
               (let* ((parameters (nthcdr n numbers)) (given (subseq numbers 0 n))
                      (states (if corrector
                                  (rest (maxima::$anmech_call check (maxima-list given) (maxima-list parameters)))
                                  given)))
                 (unless pattern (begin-pattern states parameters))
                 (task-begun pattern (append states (cons (first interval) parameters)))))
             (task-or-trouble (numbers)
               (if (or corrector (assoc 'maxima::$projection options))
                   (handler-case (task numbers) (maxima::maxima-$error () (text-of-error)))
                   (task numbers)))
             (begun (row)
               "The task of ROW, or what is wrong with it."
               (let* ((row (rest row))
                      (numbers (or (trouble-with-numbers row (rest varied))
                                   (numbers-of-point numbers places row (rest dependent) exactly)))
                      (task (if (stringp numbers) numbers (task-or-trouble numbers))))
                 (or (and (task-p task) (not corrector)
                          (trouble-with-start (problem-start (task-problem task)) check (rest constraints)))
                     task)))
             (note-motion (motion)
               (let* ((found (values-at-end motion reader)) (none (eq found :none)))
                 (note (if none nothing (maxima-list found)) (time-reached motion)
                       (or (motion-error-estimate motion) 'maxima::$unknown)
                       (or (sentences (motion-message motion)
                                      (and none "one of the expressions has no real value there"))
                           (cond ((motion-unverified motion) 'maxima::$unverified)
                                 ((motion-enclosure motion) 'maxima::$proved)
                                 (t 'maxima::$complete)))
                       (mapcar (lambda (function) (maxima::$anmech_call function motion)) (rest kept)))))
             (note-block (rows)
               (let* ((begun (mapcar (lambda (row) (if (interrupted-p) *not-begun* (begun row))) rows))
                      (motions (motions-of-block (remove-if-not #'task-p begun) integrator (rest kept))))
                 (dolist (task begun)
                   (poll)
                   (let ((motion (and (task-p task) (pop motions))))
                     (cond (motion (note-motion motion))
                           ((stringp task) (note-trouble task))
                           ((interrupted-p) (note-trouble *not-begun*))
                           (t (handler-case (note-motion (motion-of-task task integrator))
                                (maxima::maxima-$error () (note-trouble (text-of-error)))))))
                   (incf done)
                   (when (and line (not (interrupted-p))) (funcall line "" (/ done count)))))))
      (call-noting-interruptions
       (lambda ()
         (if (together-p integrator options)
             (map-in-blocks #'note-block (rest rows) model interval)
             (dolist (row (rest rows)) (note-block (list row))))))
      (when line (funcall line))
      (flet ((lists (lists) (mapcar (lambda (list) (maxima-list (nreverse list))) lists)))
        (maxima-list (append (lists (list all ends errors statuses)) (list (maxima-list (lists kept-lists)))))))))
