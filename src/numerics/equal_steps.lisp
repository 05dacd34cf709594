;;; anmech: integration by steps of equal length, whose error is estimated by steps twice as long.
;;;
;;; A method that keeps a structure of the motion keeps it only while its step is one and the same.  So its user chooses
;;; the step, not the accuracy; the motion is integrated again with half as many steps, and the difference is told.
;;;
;;; What a method adds is a *walker*, made for a start and a step, which takes one step after the other.  There may be
;;; millions of steps; only some two thousand states are kept, and the walker's function VALUE gives those between, as a
;;; rule by taking the steps from the last one that was kept again.
;;;
;;; Entry points: the structure WALKER; MOTION-OF-EQUAL-STEPS; STEP-SIZE-TROUBLE.

(in-package :anmech)
(needs "session/patience" "session/texts" "arithmetic/floats" "numerics/dag" "numerics/doubles"
       "numerics/integration" "numerics/model" "numerics/motion" "numerics/progress" "numerics/projection"
       "numerics/weights")

(defstruct walker
  "ADVANCE  function (count): go on until COUNT steps are taken since the start; nil, or what prevented it: :unsolved,
         or a condition of the field
TAKEN    function: how many steps are taken
STATE    function (time out): the states of the system after them go to OUT; nil if they cannot be found
COST     function: how often the equations were evaluated
VALUE    function (states time later out): the states at LATER, from STATES at TIME, go to OUT"
  trouble                      ; what is wrong at the start already, as of ADVANCE
  advance taken state cost value)

(defun step-size-trouble (method options)
  "What is wrong with the step_size among OPTIONS, a sentence, or nil."
  (let* ((given (assoc 'maxima::$step_size options)) (exact (and given (exact-value (cdr given)))))
    (cond ((null given)
           (format nil "method = ~a needs a step_size, such as step_size = 0.01" method))
          ((not (and exact (plusp exact)))
           (format nil "step_size must be a positive number, found ~a" (one-line (cdr given)))))))

;;; One integration

(defparameter *most-nodes* 2000 "About how many states are kept.")

(defun integrate-by-walker (make-walker problem start n t1 count stride progress)
  "COUNT steps from START to T1, of which the states after every STRIDE steps are kept: an integration."
  (let* ((t0 (aref start n))
         (step (/ (- t1 t0) (max count 1)))
         (walker (funcall make-walker problem start step))
         (time t0)
         (states (subseq start 0 n))
         (kept '())                             ; pairs (time . states)
         (clock (get-internal-real-time))
         (trouble (walker-trouble walker)))
    (flet ((taken () (funcall (walker-taken walker))))
      (loop for target = (min count (+ (taken) stride))
            until (or trouble (= (taken) count))
            do (setq trouble (advance-interruptibly walker target))
               (unless trouble
                 (let ((later (if (= target count) t1 (+ t0 (* target step)))) (found (zeros n)))
                   (cond ((funcall (walker-state walker) later found)
                          (push (cons time states) kept)
                          (setq time later states found))
                         (t (setq trouble :unsolved)))))
               (when (and progress (> (- (get-internal-real-time) clock) (/ internal-time-units-per-second 2)))
                 (setq clock (get-internal-real-time))
                 (funcall progress (/ (taken) count))))
      (let ((steps (coerce (nreverse kept) 'simple-vector)))
        (make-integration :times (times-of-nodes steps time)
                          :steps steps
                          :interpolant (lambda (kept time out n)
                                         (declare (ignore n))
                                         (funcall (walker-value walker) (cdr kept) (car kept) time out))
                          :final states
                          :accepted (taken) :rejected 0 :evaluations (funcall (walker-cost walker))
                          :status (if trouble :stopped :ok)
                          :message (and trouble (trouble-on-the-way trouble time)))))))

(defparameter *steps-at-once* 256)

(defun advance-interruptibly (walker target)
  "Go on until TARGET steps are taken; nil, or what prevented it, :interrupted among that."
  (loop for taken = (funcall (walker-taken walker))
        until (= taken target)
        do (poll)
           (when (interrupted-p) (return :interrupted))
           (let ((trouble (funcall (walker-advance walker) (min target (+ taken *steps-at-once*)))))
             (when trouble (return trouble)))))

(defun times-of-nodes (steps end)
  (let ((times (zeros (1+ (length steps)))))
    (dotimes (i (length steps)) (setf (aref times i) (car (svref steps i))))
    (setf (aref times (length steps)) end)
    times))

(defun trouble-on-the-way (trouble time)
  "The sentence that says why a motion ends at TIME; TROUBLE is a condition, or :unsolved."
  (let ((time (maxima-text time)))
    (typecase trouble
      ((eql :interrupted) (format nil "interrupted at time ~a" time))
      (domain-violation (format nil "the motion ends at time ~a, or the step is too long there: ~a" time trouble))
      (t (format nil "the equations of the step after time ~a were not solved: the step is too long there, or the ~
                      motion has a singularity" time)))))

;;; A motion

(defun compared-nodes (fine coarse n stride)
  "The largest difference of the states that both keep, one of COARSE for STRIDE of FINE, relative to the largest size
so far of a state; nil if COARSE has ended before."
  (let ((largest (zeros n)) (differences (zeros n)) (worst 0d0) (nodes (integration-steps fine)))
    (flet ((compare (state other) (setq worst (max worst (largest-difference state other largest differences)))))
      (when (= (integration-time fine) (integration-time coarse))
        (loop for (nil . other) across (integration-steps coarse)
              for place from 0 by stride
              do (compare (cdr (svref nodes place)) other))
        (compare (integration-final fine) (integration-final coarse))
        worst))))

(defparameter *timed-nodes* 12 "At so many nodes it is looked how fast the states change.")

(defun rounding-of-times (problem fine n step)
  "What half a unit in the last place of the latest time makes of a state, relative to its largest size: the times of
steps are multiples of the length STEP, and so far from those that they are called."
  (let* ((nodes (integration-steps fine)) (in (copy-seq (problem-start problem)))
         (sizes (zeros n)) (rates (zeros n)) (largest-rates (zeros n)) (field (problem-field problem)))
    (declare (type function field))
    (loop for (nil . state) across nodes do (raise-to-sizes sizes state 0 1 1d0))
    (raise-to-sizes sizes (integration-final fine) 0 1 1d0)
    (handler-case
        (loop for place below (length nodes) by (max 1 (ceiling (length nodes) *timed-nodes*))
              for (time . state) = (svref nodes place)
              do (replace in state :end2 n)
                 (setf (aref in n) time)
                 (funcall field in rates)
                 (raise-to-sizes largest-rates rates 0 1 1d0)
                 (raise-to-sizes sizes rates 0 1 step))          ; nodes may be periods apart
      ((or domain-violation arithmetic-error) () nil))
    (* 0.5d0 (largest-ratio largest-rates sizes)
       (spacing-at (max (abs (problem-time problem)) (abs (integration-time fine)))))))

(defparameter *no-estimate* 0.5d0
  "Motions that differ as much as this, in units of their sizes, tell nothing of each other.")

(defparameter *most-equal-steps* 1000000000000 "More would take days.")

(defun number-of-steps (task step)
  "How many of the length STEP at most TASK needs, an even number."
  (let* ((problem (task-problem task))
         (count (/ (abs (- (problem-end problem) (problem-time problem))) (* 2 step))))
    (when (and (null (task-max-steps task)) (> count *most-equal-steps*))
      (complain "steps of ~a are too many: give max_steps, or a larger step_size" (maxima-text step)))
    (* 2 (ceiling count))))

(defun check-projection (task)
  "Constraints such a method keeps itself; moved onto anything else, it would lose the structure that it is chosen for."
  (let ((projection (problem-projection (task-problem task))))
    (when (and projection (> (projection-count projection) (projection-constraints projection)))
      (complain "steps of equal length are not projected onto integrals: project must be true or false"))))

(defun check-equal-steps (problem)
  (when (or (problem-breakpoints problem) (problem-longest problem) (some #'event-terminal (problem-events problem)))
    (complain "a method of equal steps has no breakpoints, no max_step and no terminal events")))

(defun problem-of-check (task)
  "That of TASK with entries of linear equations changed by a unit in the last place, and numbers that are no doubles
rounded to the other side: what that does is in the estimate."
  (let* ((problem (task-problem task)) (noisy (copy-problem problem)) (model (problem-model problem)))
    (setf (problem-field noisy) (field-finding-sides (noisy-smooth-field model 1) model)
          (problem-start noisy) (task-other-start task))
    noisy))

(defun motion-of-equal-steps (task make-walker &key projecting)
  "The motion of TASK with steps of its step_size at most, an even number of them; to verify, compared with one of steps
twice as long.  MAKE-WALKER is a function (problem start step); PROJECTING: its walkers project themselves.  While they
are few all states are kept."
  (unless projecting (check-projection task))
  (check-equal-steps (task-problem task))
  (with-infinities-of ((problem-model (task-problem task)))
    (motion-by-walker task make-walker)))

(defun motion-by-walker (task make-walker)
  (let* ((problem (task-problem task)) (start (problem-start problem)) (n (problem-n problem))
         (t0 (problem-time problem)) (t1 (problem-end problem))
         (wanted (number-of-steps task (to-double (exact-value (task-option task 'maxima::$step_size)))))
         (most (task-max-steps task))
         (count (if most (min wanted (* 2 (floor most 2))) wanted))
         (end (if (= count wanted) t1 (+ t0 (* (- t1 t0) (/ count (float wanted 1d0))))))
         (coarse-stride (max 1 (ceiling count (* 2 *most-nodes*))))
         (stride (if (<= count *most-nodes*) 1 (* 2 coarse-stride)))
         (progress (task-progress task))
         (fine (integrate-by-walker make-walker problem start n end count stride (telling progress "")))
         (coarse (and (task-verify task)
                      (let ((other (problem-of-check task)))
                        (integrate-by-walker make-walker other (problem-start other) n end (/ count 2) coarse-stride
                                             (telling progress "check of ")))))
         (difference (and coarse (compared-nodes fine coarse n (/ (* 2 coarse-stride) stride)))))
    (make-motion :model (problem-model problem) :integration fine :start start :reached (integration-time fine)
                 :error-estimate (and difference
                                      (two-digits (max difference
                                                       (rounding-of-times problem fine n
                                                                          (/ (abs (- end t0)) (max 1 count))))))
                 :evaluations (+ (integration-evaluations fine) (if coarse (integration-evaluations coarse) 0))
                 :message (or (integration-message fine)
                              (and (< count wanted)
                                   (format nil "~d steps were not enough: the motion was followed to time ~a"
                                           count (maxima-text end)))
                              (and difference (> difference *no-estimate*)
                                   "steps of this length do not follow the motion: twice as long ones give another")
                              (and coarse (null difference)
                                   (format nil "nothing is known of the error, for the check by steps twice as long ~
                                                ended: ~a" (integration-message coarse)))))))
