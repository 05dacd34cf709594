;;; anmech: motions with proved bounds: rigorous = true.
;;;
;;; A motion is enclosed (lohner.lisp), with all numbers as they were given, irrational ones in balls; where the set at
;;; the end is wider than the accuracy that is wanted, again, with a finer tolerance and more binary places.  What is
;;; read of it as of any motion are the midpoints, as doubles; the bounds are doubles on the outer sides.
;;;
;;; Entry points: ENCLOSED-MOTION, RIGOROUS-TROUBLE, RIGOROUS-P, BOUNDS-AT.

(in-package :anmech)
(needs "session/patience" "session/texts" "arithmetic/floats" "numerics/ball_functions" "numerics/ball_series"
       "numerics/balls" "numerics/codegen" "numerics/dag" "numerics/doubles" "numerics/evaluation"
       "numerics/integration" "numerics/lohner" "numerics/long_numbers" "numerics/model" "numerics/motion"
       "numerics/progress" "numerics/sharing" "numerics/solved_program")

;;; What is asked for

(defun rigorous-p (options)
  "Whether an alist of options asks for proved bounds."
  (eq t (cdr (assoc 'maxima::$rigorous options))))

(defun rigorous-trouble (options)
  "What is wrong with the option rigorous, a sentence, or nil."
  (let ((given (assoc 'maxima::$rigorous options)))
    (cond ((and given (not (member (cdr given) '(t nil))))
           (format nil "rigorous must be true or false, found ~a" (one-line (cdr given))))
          ((and (rigorous-p options) (assoc 'maxima::$digits options))
           "with rigorous = true there is no option digits"))))

(defparameter *finest-accuracy* 1/1000000000000000 "What doubles can tell.")

(defun check-what-bounds-leave (task)
  "Complain of what such motions do not know."
  (let* ((problem (task-problem task))
         (option (cond ((problem-events problem) "events") ((problem-breakpoints problem) "breakpoints")
                       ((problem-longest problem) "max_step") ((problem-projection problem) "project")
                       ((not (task-verify task)) "verify"))))
    (when option (complain "with rigorous = true there is no option ~a" option))
    (when (< (task-accuracy task) *finest-accuracy*)
      (complain "with rigorous = true bounds are doubles: the accuracy must be at least 1e-15"))
    (when (problem-surfaces problem)
      (complain "rigorous = true needs equations without kinks (abs, signum, max, min, unit_step, conditionals)"))))

;;; What is given

(defun balls-of-forms (forms)
  "Those of FORMS, numbers of Maxima."
  (let ((program (with-compilation-errors (lambda () (expressions-program forms '() :round-constants nil)))))
    (handler-case (funcall (the function (program-function program (ball-numbers))) #())
      (domain-violation (condition) (complain "~a" condition)))))

(defparameter *time-digits* 60 "A time is the rational number of so many digits that is next to what is given.")

(defun exact-time (form) (exact-value form *time-digits*))

(defun farthest-end (start end)
  "END, or the double next to it, whichever is farther from START: both can be asked for."
  (let ((double (rational (to-double end))))
    (if (> (abs (- double start)) (abs (- end start))) double end)))

(defun double-inside (time start)
  "The double next to TIME that is not beyond it as seen from START."
  (let ((double (to-double time)))
    (if (> (abs (- (rational double) start)) (abs (- time start))) (neighbour double start) double)))

;;; Passes

(defparameter *accuracy-part* -20 "The tolerance of the first pass, in proportion to the accuracy: binary logarithm.")
(defparameter *bits-beyond* 24 "Of midpoints, beyond the tolerance.")
(defparameter *most-enclosed-steps* 100000)
(defparameter *enclosing-passes* 4)

(defun enclosing-order (tolerance)
  "TOLERANCE is a binary logarithm."
  (max 8 (ceiling (- 4 (* tolerance 0.3d0)))))

(defparameter *most-small-bits* 1000)

(defun bits-for (tolerance small)
  "The binary places for a TOLERANCE, a binary logarithm, where the first SMALL of a number may be 0."
  (+ (ceiling (- tolerance)) *bits-beyond* small))

(defun small-places (program inputs)
  "How many binary places are 0 in the smallest number but 0 that PROGRAM, of rates and their derivatives, computes, or
that is among its rational INPUTS."
  (let ((smallest 0) (numbers (long-numbers 64)))
    (flet ((note (number)
             (unless (zerop number) (setq smallest (min smallest (binary-logarithm number))))
             number))
      (map nil #'note inputs)
      (handler-case
          (funcall (the function
                        (program-function program
                                          (make-number-type
                                           :number (number-type-number numbers) :constant (number-type-constant numbers)
                                           :operate (lambda (&rest arguments)
                                                      (note (or (apply (number-type-operate numbers) arguments)
                                                                (error 'domain-violation :source nil
                                                                       :operation (first arguments))))))))
                   inputs)
        (domain-violation () nil))
      (min *most-small-bits* (ceiling (- smallest))))))

(defun renewing (task pivots)
  "A function (enclosure): of the rates and their derivatives the program with pivots that are good where it has come
to, and its places; nil while these are in the rows PIVOTS, or those that it found last.  Where motions turn, pivots
that were chosen at their beginning vanish."
  (let* ((model (problem-model (task-problem task))) (n (model-dimension model)) (exact (task-exact task)))
    (lambda (enclosure)
      (when pivots
        (let ((inputs (concatenate 'vector (map 'list #'ball-value (enclosure-center enclosure))
                                   (list (enclosure-time enclosure)) (nthcdr (1+ n) exact))))
          (multiple-value-bind (solved found) (handler-case (solved-program model inputs)
                                                (domain-violation () (values nil nil)))
            (when (and solved (not (equal found pivots)))
              (setq pivots found)
              (varied-program (program-of-rates solved n) n))))))))

(defun enclosing-pass (task program places pivots tolerance small progress)
  "TOLERANCE is a binary logarithm; SMALL as for BITS-FOR."
  (let* ((problem (task-problem task)) (n (problem-n problem)) (bits (bits-for tolerance small))
         (start (exact-time (nth n (task-given task))))
         (end (farthest-end start (exact-time (task-given-end task))))
         (*ball-bits* bits)
         (inputs (coerce (balls-of-forms (task-given task)) 'vector))
         (enclosure (new-enclosure program places n inputs bits (enclosing-order tolerance) small)))
    (setf (enclosure-wanted enclosure) (rational (task-accuracy task))
          (enclosure-renew enclosure) (renewing task pivots))
    (enclose-motion enclosure start end (expt 2 (ceiling tolerance)) (or (task-max-steps task) *most-enclosed-steps*)
                    progress)))

(defun enclosed-motion (task)
  "The motion of TASK with its bounds."
  (check-what-bounds-leave task)
  (let* ((problem (task-problem task)) (model (problem-model problem)) (n (problem-n problem))
         (accuracy (rational (task-accuracy task)))
         (tolerance (+ (binary-logarithm accuracy) *accuracy-part*)) (best nil) (before nil) (evaluations 0)
         (both (multiple-value-list (solved-program model (coerce (task-exact task) 'vector))))
         (solved (first both)) (pivots (second both)))
    (multiple-value-bind (program places) (varied-program (program-of-rates solved n) n)
      (loop with small = (small-places program (coerce (task-exact task) 'vector))
            for number from 1 to *enclosing-passes*
            do (let ((pass (enclosing-pass task program places pivots tolerance small
                                           (telling (and (task-progress task)
                                                         (progress-of-pass (task-progress task) number))
                                                    ""))))
                 (incf evaluations (enclosure-evaluations pass))
                 (when (or (null best) (better-enclosure-p pass best)) (setq best pass))
                 (when (or (interrupted-p) (settled-enclosure-p pass accuracy before)) (return))
                 (setq tolerance (finer-tolerance tolerance pass accuracy) before pass)))
      (setf (enclosure-solved best) solved)
      (motion-of-enclosure best problem evaluations))))

(defun program-of-rates (program n)
  (let ((rates (copy-program program)))
    (setf (program-results rates) (subseq (program-results program) 0 n))
    rates))

(defun way (enclosure) (abs (- (enclosure-time enclosure) (enclosure-start enclosure))))

(defun better-enclosure-p (first second)
  (or (> (way first) (way second))
      (and (= (way first) (way second)) (< (enclosure-widest first) (enclosure-widest second)))))

(defun settled-enclosure-p (enclosure accuracy before)
  "Whether nothing more is wanted, or to be had: where the last pass but one, BEFORE, has met the same obstacle."
  (let ((trouble (enclosure-trouble enclosure)))
    (or (member trouble '(:interrupted :too-many-steps))
        (and (null trouble) (<= (enclosure-widest enclosure) accuracy))
        (and trouble before (not (eq :too-wide trouble)) (<= (way enclosure) (* 101/100 (way before)))))))

(defun finer-tolerance (tolerance enclosure accuracy)
  (let ((widest (enclosure-widest enclosure)))
    (+ tolerance
       (if (or (enclosure-trouble enclosure) (zerop widest))
           -40
           (max -40 (- (binary-logarithm accuracy) (binary-logarithm widest) 3))))))

;;; The motion

(defun end-of-enclosure (enclosure)
  "A double; where nothing follows the start, that next to it."
  (let ((time (enclosure-time enclosure)) (start (enclosure-start enclosure)))
    (if (= time start) (to-double time) (double-inside time start))))

(defun error-of-enclosure (enclosure)
  "With what doubles leave away of midpoints."
  (two-digits (to-double (+ (enclosure-widest enclosure) (expt 2 -52)))))

(defun motion-of-enclosure (enclosure problem evaluations)
  (make-motion :model (problem-model problem) :integration (integration-of-enclosure enclosure)
               :start (problem-start problem)
               :reached (end-of-enclosure enclosure)
               :error-estimate (error-of-enclosure enclosure)
               :evaluations evaluations
               :message (sentence-of-enclosure enclosure)
               :enclosure enclosure))

(defun sentence-of-enclosure (enclosure)
  (let ((time (maxima-text (end-of-enclosure enclosure))) (trouble (enclosure-trouble enclosure)))
    (sentences
     (case trouble
       ((nil) nil)
       (:interrupted (format nil "interrupted: the enclosure holds until time ~a" time))
       (:too-many-steps (format nil "the enclosure holds until time ~a: more than ~d steps; give max_steps" time
                                (length (enclosure-links enclosure))))
       (:too-wide (format nil "the enclosure holds until time ~a: beyond it grew wider than an eighth of a state" time))
       (:too-large (format nil "the enclosure holds until time ~a: what follows is too large for doubles" time))
       (:too-short (format nil "the enclosure holds until time ~a: its steps become too short there" time))
       (t (format nil "the enclosure holds until time ~a: in what would hold the next step, ~a" time trouble)))
     (and (> (enclosure-widest enclosure) (enclosure-wanted enclosure))
          (not (eq :too-wide trouble))
          (format nil "the enclosure is wider than the accuracy: by up to ~a"
                  (short-text (error-of-enclosure enclosure)))))))

(defun integration-of-enclosure (enclosure)
  "Its midpoints, for those who read doubles."
  (let ((links (enclosure-links enclosure)))
    (make-integration :times (doubles (append (map 'list (lambda (link) (to-double (link-time link))) links)
                                              (list (end-of-enclosure enclosure))))
                      :steps links
                      :interpolant (lambda (link time out n)
                                     (declare (ignore link n))
                                     (map-into (the double-array out) #'to-double
                                               (middle-states enclosure (time-of-enclosure enclosure time))))
                      :final (map 'double-array #'to-double
                                  (middle-states enclosure (time-of-enclosure enclosure (end-of-enclosure enclosure))))
                      :accepted (length links) :rejected (enclosure-rejected enclosure)
                      :evaluations (enclosure-evaluations enclosure)
                      :status (if (enclosure-trouble enclosure) :stopped :ok)
                      :message (and (enclosure-trouble enclosure) (sentence-of-enclosure enclosure)))))

(defun time-of-enclosure (enclosure time)
  "TIME, a double, which may have been rounded beyond the ends: for midpoints, which are rounded, too."
  (let ((low (min (enclosure-start enclosure) (enclosure-time enclosure)))
        (high (max (enclosure-start enclosure) (enclosure-time enclosure))))
    (max low (min high (rational time)))))
