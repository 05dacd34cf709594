;;; Motions: fields made of equations, and integration to a wanted accuracy of the result.
;;;
;;; Entry points: $anmech_motion_model, $anmech_motion.  What can be read off a motion is in motion_reading.lisp.
;;;
;;; A method of integration bounds the error of one step; what a user asks for is an error of the whole. So a motion is
;;; integrated twice, the second time with a tolerance ten times coarser, and both are compared at every step; if they
;;; differ by more than was asked for, both are done again with a finer tolerance.  The difference is the error of the
;;; coarser motion, and the finer one is handed out: the estimate is on the safe side.  Besides, the coarser one starts
;;; from the other neighbouring doubles wherever a given number had to be rounded, and its field sees every state
;;; changed by one unit in the last place: so the estimate also holds what rounding does in the end.
;;;
;;; Literature: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed. 1993, II.4;
;;; L. F. Shampine, Tolerance proportionality in ODE codes, Lecture Notes in Mathematics 1386 (1989) 118-136.

(in-package :anmech)
(needs "arithmetic/floats" "arithmetic/linear" "numerics/codegen" "numerics/dag" "numerics/doubles"
       "numerics/integrators/dop853")

;;; Fields

(defstruct (model (:print-function print-dots))
  states          ; jets, as many as the field has rates
  time
  parameters      ; symbols; the inputs of all compiled code are the states, the time and the parameters
  unknowns        ; jets of the highest derivatives, then the multipliers
  field           ; function (in out): the rates
  solver          ; function (in out): the unknowns
  (size 0)        ; the number of linear equations A u = b; 0 if the rates are given
  solved          ; the place from which on rates are the first unknowns
  system          ; function (in array): the entries of A and b
  seconds)        ; what compiling took, until a motion tells of it

(defun print-dots (object stream depth)
  (declare (ignore object depth))
  (write-string "..." stream))

(defun model-inputs (model)
  (append (model-states model) (list (model-time model)) (model-parameters model)))

(defun seconds-since (start)
  (/ (float (- (get-internal-real-time) start) 1d0) internal-time-units-per-second))

(defun make-motion-model (states velocities time parameters unknowns equations size)
  "The first of STATES are coordinates with VELOCITIES, states too; the rates of the others are the first unknowns.
EQUATIONS are the entries of A and b of SIZE equations; or, with SIZE 0, the rates."
  (let* ((start (get-internal-real-time))
         (model (make-model :states states :time time :parameters parameters :unknowns unknowns :size size
                            :solved (length velocities)))
         (system (with-compilation-errors (lambda () (compile-expressions equations (model-inputs model)))))
         (n (- (length states) (length velocities))))
    (flet ((place (velocity) (position velocity states)))
      (setf (model-system model) system
            (model-field model) (if (zerop size) system (make-implicit-field (mapcar #'place velocities) n size system))
            (model-solver model) (if (zerop size) system (make-implicit-field '() size size system))
            (model-seconds model) (seconds-since start)))
    model))

(maxima::defmfun maxima::$anmech_motion_model (states velocities time parameters unknowns equations size)
  "anmech_motion_model(states, velocities, time, parameters, unknowns, equations, size): compiled equations of motion."
  (make-motion-model (rest states) (rest velocities) time (rest parameters) (rest unknowns) (rest equations) size))

;;; A motion

(defstruct (motion (:print-function print-dots))
  model
  integration                       ; of the kernel, with dense output
  start                             ; double array: first states, time, parameters
  reached                           ; the time up to which it is given
  error-estimate                    ; nil if not verified
  tolerance                         ; of one step
  (evaluations 0) (seconds 0d0)     ; of all integrations together
  (compile-seconds 0d0)             ; 0 if another motion has made use of the code before
  message                           ; why it is not what was asked for; nil if it is
  (facts '()))                      ; what the layer above notes: pairs (name . value)

(defun motion-dimension (motion) (length (model-states (motion-model motion))))
(defun start-time (motion) (aref (motion-start motion) (motion-dimension motion)))

(defun state-at (motion time in)
  "Write state, time and parameters at TIME to IN."
  (replace in (motion-start motion))
  (dense-value (motion-integration motion) time in)
  (setf (aref in (motion-dimension motion)) time)
  in)

;;; The sizes that errors are measured by

(defstruct weights
  least          ; of each state: the size that it is taken to have at least
  grains)        ; in the order of time, pairs of a time and, of each state there, the size of the terms it is made of

(defun rate-terms (field in n amplitudes rates)
  "Raise RATES to how much each rate changes in proportion to relative changes of the single states."
  (declare (type function field) (fixnum n) (type (simple-array double-float (*)) in amplitudes rates))
  (let ((before (make-array n :element-type 'double-float)) (after (make-array n :element-type 'double-float))
        (found (make-array n :element-type 'double-float :initial-element 0d0)))
    (declare (type (simple-array double-float (*)) before after found))
    (handler-case
        (progn
          (funcall field in before)
          (dotimes (j n)
            (let ((state (aref in j)))
              (setf (aref in j) (+ state (* 1d-6 (aref amplitudes j))))
              (unwind-protect (funcall field in after)
                (setf (aref in j) state)))
            (with-fast-arithmetic
              (for (i n)
                (setf (aref found i) (flo (+ (aref found i) (* 1d6 (abs (- (aref after i) (aref before i))))))))))
          (map-into rates #'max rates found (map 'double-array #'abs before)))
      ((or domain-violation arithmetic-error) () nil))))

(defun solution-terms (model in)
  "How much each of the unknowns of A u = b at IN changes in proportion to relative changes of the entries of A and b.
The changes, of either sign, are drawn at random a few times: the condition that Skeel has defined, but for the exact
bound."
  (let* ((size (model-size model))
         (entries (make-array (* size (1+ size)) :element-type 'double-float))
         (found (make-array size :element-type 'double-float :initial-element 0d0))
         (part 1d-7) (seed 1))
    (declare (fixnum size seed) (double-float part))
    (flet ((solution (part)
             (let ((matrix (copy-seq entries)))
               (declare (type (simple-array double-float (*)) matrix) (double-float part))
               (dotimes (i (length matrix))
                 (setq seed (mod (* 16807 seed) 2147483647))
                 (setf (aref matrix i) (* (aref matrix i) (if (logbitp 10 seed) (+ 1d0 part) (- 1d0 part)))))
               (let ((right (subseq matrix (* size size))))
                 (and (solve-linear-in-place size matrix right) right)))))
      (handler-case
          (progn
            (funcall (the function (model-system model)) in entries)
            (let ((plain (solution 0d0)))
              (loop repeat 4
                    do (let ((other (solution part)))
                         (when (and plain other)
                           (map-into found
                                     (lambda (terms u v) (max terms (/ (abs (- u v)) part)))
                                     found plain other))))))
        ((or domain-violation arithmetic-error) () nil))
      found)))

(defun grain-at (model point period n)
  "The grain of each state: what the terms of its rate give in the short time PERIOD.  POINT is like the input of the
field.  A second round brings in states that are zero themselves, but whose rates have terms that cancel."
  (let ((grain (make-array n :element-type 'double-float :initial-element 0d0))
        (terms (and (plusp (model-size model)) (solution-terms model point))))
    (dotimes (round 2 grain)
      (let ((rates (make-array n :element-type 'double-float :initial-element 0d0)))
        (when terms (replace rates terms :start1 (model-solved model)))
        (rate-terms (model-field model) point n
                    (map 'double-array (lambda (g state) (max g (abs state))) grain (subseq point 0 n))
                    rates)
        (dotimes (i n)
          (when (< (aref rates i) 1d200)
            (setf (aref grain i) (max (aref grain i) (* period (aref rates i))))))))))

(defun first-weights (model start n t1)
  "Before anything is known but the beginning."
  (let* ((field (model-field model))
         (rates (make-array n :element-type 'double-float :initial-element 0d0))
         (period (* 0.01d0 (abs (- t1 (aref start n)))))
         (point (copy-seq start)))
    (handler-case (funcall (the function field) point rates)
      ((or domain-violation arithmetic-error) () nil))
    (dotimes (i n)
      (let ((state (abs (aref start i))) (rate (abs (aref rates i))))
        (when (and (plusp state) (< state (* rate period)))
          (setq period (/ state rate)))))
    (make-weights :least (least-from-rest (map 'double-array (lambda (rate) (* 0.01d0 period (abs rate))) rates) start)
                  :grains (list (cons (aref start n) (grain-at model point period n))))))

(defun least-from-rest (least start)
  "LEAST, where a state that is at rest in 0 has a small part of what the others have: nothing else tells of its size."
  (let ((part (* 1d-6 (reduce #'max least))))
    (map 'double-array (lambda (size state) (if (zerop state) (max size part) size))
         least (subseq start 0 (length least)))))

(defparameter *points* 12 "At how many points the grain is measured.")
(defparameter *negligible* 1d-6
  "The part of its largest size that a state which begins at 0 is taken to have at least: what grows out of rest, like
t^5, would be asked for digits that no one can see.")

(defun least-size (integration i)
  (flet ((state (step) (abs (aref (the double-array step) (+ 2 (* 8 i))))))
    (let ((steps (integration-steps integration)))
      (if (and (plusp (length steps)) (zerop (state (svref steps 0))))
          (* *negligible* (reduce #'max steps :key #'state))
          0d0))))

(defun measured-weights (model start n integration)
  "From a motion that has been integrated."
  (let ((steps (integration-steps integration))
        (least (make-array n :element-type 'double-float)))
    (dotimes (i n) (setf (aref least i) (least-size integration i)))
    (make-weights
     :least least
     :grains (loop for k from 0 below (length steps) by (max 1 (ceiling (length steps) *points*))
                   collect (let ((point (copy-seq start)) (step (svref steps k)))
                             (declare (type (simple-array double-float (*)) step))
                             (dotimes (i n) (setf (aref point i) (aref step (+ 2 (* 8 i)))))
                             (setf (aref point n) (aref step 0))
                             (cons (aref step 0) (grain-at model point (abs (aref step 1)) n)))))))

(defparameter *rounding* 1d-16 "The part of the grain below which the error of a step is noise.")
(defparameter *noise* 1d-14 "The part of it below which a difference after many steps is.")

(defun growing-tolerances (weights tolerance start n)
  "The absolute tolerances at START, and an observer of a motion that lets them grow with the largest sizes of its
states."
  (declare (fixnum n) (double-float tolerance))
  (let* ((tolerances (make-array n :element-type 'double-float))
         (observer (lambda (in)
                     (declare (type (simple-array double-float (*)) in tolerances))
                     (with-fast-arithmetic
                       (for (i n)
                         (setf (aref tolerances i) (flo (max (aref tolerances i) (* tolerance (abs (aref in i)))))))
                       nil))))
    (dotimes (i n)
      (setf (aref tolerances i) (max (* tolerance (aref (weights-least weights) i))
                                     (* *rounding* (loop for (nil . grain) in (weights-grains weights)
                                                         minimize (aref grain i))))))
    (funcall observer start)
    (values tolerances observer)))

;;; Two integrations and their difference

(defstruct difference
  (error 0d0)                       ; the largest difference of a state, in units of its largest size so far
  good-until                        ; the last time until which it was below the wanted accuracy
  (good-error 0d0))                 ; the largest until then

(defun compared (fine coarse n weights accuracy)
  "The difference of two integrations with dense output, where the steps of the coarser one end and twice in between."
  (let* ((comparison (make-difference :good-until (integration-start fine)))
         (state (make-array n :element-type 'double-float))
         (other (make-array n :element-type 'double-float))
         (largest (copy-seq (weights-least weights)))
         (grains (weights-grains weights))
         (end (integration-time fine))
         (forward (>= end (integration-start fine))))
    (labels ((later-p (time other) (if forward (> time other) (< time other)))
             (compare (time)
               (loop until (or (null grains) (later-p (car (first grains)) time))
                     do (map-into largest (lambda (size grain) (max size (/ (* *noise* grain) accuracy)))
                                  largest (cdr (pop grains))))
               (dense-value fine time state)
               (dense-value coarse time other)
               (note-difference comparison time (largest-difference state other largest) accuracy)))
      (loop for (start . more) on (coerce (integration-times coarse) 'list)
            while (and more (not (later-p (first more) end)))
            do (dolist (part '(1 2 3))
                 (compare (if (= part 3) (first more) (+ start (* (/ part 3d0) (- (first more) start))))))))
    comparison))

(defun largest-difference (state other largest)
  "Of two states, in units of LARGEST, their largest sizes so far, which are brought up to date."
  (declare (type (simple-array double-float (*)) state other largest))
  (with-fast-arithmetic
    (let ((worst 0d0))
      (declare (double-float worst))
      (for (i (length state))
        (setf (aref largest i) (flo (max (aref largest i) (abs (aref state i)))))
        (let ((difference (flo (abs (- (aref state i) (aref other i))))))
          (declare (double-float difference))
          (when (> difference 0d0)
            (setq worst (flo (max worst (/ difference (max (aref largest i) 1d-300))))))))
      worst)))

(defun note-difference (comparison time difference accuracy)
  (setf (difference-error comparison) (max difference (difference-error comparison)))
  (unless (> (difference-error comparison) accuracy)
    (setf (difference-good-until comparison) time
          (difference-good-error comparison) (difference-error comparison))))

(defun joined-differences (first second)
  (make-difference :error (max (difference-error first) (difference-error second))
                   :good-until (if (< (difference-good-error first) (difference-good-error second))
                                   (difference-good-until first)
                                   (difference-good-until second))
                   :good-error (max (difference-good-error first) (difference-good-error second))))

(defparameter *finest* 5d-16 "The finest tolerance that makes sense.")
(defparameter *fine* 1d-14 "A tolerance from which on rounding matters.")

(defun shifted-field (field start other-start n direction)
  "FIELD that sees every state a unit in the last place away, in the direction, if there is one, from START to
OTHER-START; or, if DIRECTION is -1, in the opposite one."
  (declare (type function field) (fixnum n))
  (let ((seen (copy-seq start))
        (factors (make-array n :element-type 'double-float)))
    (declare (type (simple-array double-float (*)) seen factors))
    (dotimes (i n)
      (let* ((difference (- (abs (aref other-start i)) (abs (aref start i))))
             (side (if (or (plusp difference) (and (zerop difference) (evenp i))) 1 -1)))
        (setf (aref factors i) (+ 1d0 (* 2.3d-16 direction side)))))
    (lambda (in out)
      (declare (type (simple-array double-float (*)) in out))
      (with-fast-arithmetic
        (for (i n) (setf (aref seen i) (flo (* (aref factors i) (aref in i)))))
        (for (i (length seen) n) (setf (aref seen i) (aref in i)))
        (funcall field seen out)
        nil))))

(defun integrate-field (field start n t1 tolerance weights max-steps progress)
  "An integration whose steps have an error of TOLERANCE, relative to the largest size so far of each state."
  (multiple-value-bind (tolerances observer) (growing-tolerances weights tolerance start n)
    (dop853 field (copy-seq start) n t1 :relative (* 0.1d0 tolerance) :absolute tolerances :observer observer
                                        :max-steps max-steps :dense t :progress progress)))

(defun coarser (tolerance)
  "The tolerance of the second integration; near the finest possible, less is left between both."
  (* tolerance (if (<= tolerance *finest*) 4d0 10d0)))

(defun motion-of-pass (model start other-start t1 accuracy tolerance weights verify max-steps progress)
  "Integrate with TOLERANCE and, to VERIFY, with a coarser one: a motion, what was seen in comparing, and better
weights."
  (let* ((n (length (model-states model)))
         (field (model-field model))
         (fine (integrate-field field start n t1 tolerance weights max-steps (telling progress "")))
         (weights (if verify (measured-weights model start n fine) weights))
         (motion (make-motion :model model :integration fine :start start :reached (integration-time fine)
                              :tolerance tolerance :evaluations (integration-evaluations fine))))
    (flet ((comparison (from tolerance direction)
             (let ((coarse (integrate-field (shifted-field field start other-start n direction) from n t1 tolerance
                                            weights max-steps (telling progress "check of "))))
               (incf (motion-evaluations motion) (integration-evaluations coarse))
               (compared fine coarse n weights accuracy))))
      (let ((comparison (if verify
                            (comparison other-start (coarser tolerance) 1)
                            (make-difference :good-until (integration-time fine)))))
        ;; near the limit the difference is one of chance: two are better than one
        (when (and verify (<= tolerance *fine*))
          (setq comparison (joined-differences comparison (comparison start (* 1.5d0 tolerance) -1))))
        (values motion comparison weights)))))

(defun rounding-limited-p (error tolerance previous-error previous-tolerance)
  "Whether the error has not fallen as the tolerance has: then rounding governs it."
  (and previous-error
       (<= tolerance *fine*)
       (> error (* 2 previous-error (/ (coarser tolerance) (coarser previous-tolerance))))))

(defun next-tolerance (tolerance ratio)
  "A finer tolerance, where RATIO is the wanted error by that which was found; short of the finest, a stop is made."
  (max (if (> tolerance (* 2 *fine*)) *fine* *finest*)
       (* tolerance (max 1d-4 (min 0.1d0 (* 0.4d0 ratio))))))

(defun motion-trouble (motion)
  "The sentence that says why it ends early, or nil."
  (integration-message (motion-integration motion)))

(defun out-of-steps-p (motion)
  (eq :too-many-steps (integration-status (motion-integration motion))))

(defun better-p (motion error best least)
  "Whether a later motion is to be preferred.  One that meets with an obstacle is, since it looks closer than those
before."
  (cond ((null best) t)
        ((out-of-steps-p motion) nil)
        ((or (motion-trouble motion) (motion-trouble best)) t)
        (t (< error least))))

(defun last-pass-p (motion error accuracy tolerance previous-error)
  (cond ((or (<= tolerance *finest*) (out-of-steps-p motion)) t)
        ((motion-trouble motion) (<= tolerance *fine*))
        (t (or (<= error accuracy)
               (and previous-error (<= tolerance *fine*) (< (* 0.5d0 previous-error) error))))))

(defun integrate-motion (model start other-start t1 accuracy verify max-steps progress)
  "The motion of MODEL from START, which holds states, time and parameters; OTHER-START is the same, rounded otherwise."
  (let* ((clock (get-internal-real-time))
         (weights (first-weights model start (length (model-states model)) t1))
         (tolerance (if verify (max (/ accuracy 10) 1d-6) (/ accuracy 10)))
         (best nil) (least nil) (evaluations 0) (previous-error nil) (previous-tolerance nil))
    (loop for pass from 1
          do (multiple-value-bind (motion comparison better-weights)
                 (motion-of-pass model start other-start t1 accuracy tolerance weights verify max-steps
                                 (and progress (progress-of-pass progress pass)))
               (let ((error (difference-error comparison)))
                 (when (rounding-limited-p error tolerance previous-error previous-tolerance)
                   (setq error (* 3 error)))
                 (incf evaluations (motion-evaluations motion))
                 (when (better-p motion error best least)
                   (setq best motion least error)
                   (finish-motion motion comparison error accuracy verify))
                 (when (or (not verify) (last-pass-p motion error accuracy tolerance previous-error))
                   (return))
                 (setq weights better-weights
                       previous-error error
                       previous-tolerance tolerance
                       tolerance (next-tolerance tolerance (if (motion-trouble motion) 0d0 (/ accuracy error)))))))
    (setf (motion-error-estimate best) (and verify (two-digits (motion-error-estimate best)))
          (motion-evaluations best) evaluations
          (motion-seconds best) (seconds-since clock)
          (motion-compile-seconds best) (model-seconds model)
          (model-seconds model) 0d0)
    best))

(defun finish-motion (motion comparison error accuracy verify)
  "Note the estimate of the error, and say what is to be said.  A motion that ends at an obstacle is given as far as it
is accurate: where it ends, it need not be."
  (let ((trouble (motion-trouble motion)) (bad (and verify (> error accuracy))))
    (setf (motion-error-estimate motion) (and verify error))
    (cond ((and trouble verify (or bad (not (out-of-steps-p motion))))
           (setf (motion-reached motion) (difference-good-until comparison)
                 (motion-error-estimate motion) (difference-good-error comparison)
                 (motion-message motion) trouble))
          (trouble (setf (motion-message motion) trouble))
          (bad (setf (motion-message motion) (format nil "the accuracy of ~a was not reached, only ~a"
                                                     (short-text accuracy) (short-text error)))))))

;;; Progress

(defun progress-of-pass (progress pass)
  (lambda (what part) (funcall progress (format nil "~apass ~d" what pass) part)))

(defun telling (progress what)
  "What dop853 is to call."
  (and progress (lambda (part) (funcall progress what part))))

(defun terminal-p ()
  "Whether somebody sees at once what is written.  Only SBCL knows it by itself."
  #+sbcl (interactive-stream-p *standard-output*)
  #-sbcl (handler-case (eql 0 (#+gcl si:system #+ecl ext:system #-(or gcl ecl) identity "test -t 1"))
           (error () nil)))

(defun progress-line (mode)
  "A function (what part) that shows, after two seconds, how far it is; without arguments, that it is over.
MODE is true, false, or auto: a line for somebody who waits at a prompt, none while a file is read."
  (let ((start (get-internal-real-time)) (terminal :unknown) (shown nil))
    (flet ((show (text)
             (cond ((fboundp 'maxima::$wxstatusbar) (funcall 'maxima::$wxstatusbar text))
                   (terminal (write-char #\Return) (format t "~60a" text) (write-char #\Return))
                   ((string/= text "") (format t "~a~%" text)))
             (finish-output)))
      (and mode
           (or (eq mode t) (null maxima::$load_pathname))
           (lambda (&optional what part)
             (when (and what (> (seconds-since start) 2))
               (when (eq terminal :unknown) (setq terminal (terminal-p)))
               (let ((now (list what (if terminal (floor (* 100 part)) (* 10 (floor (* 10 part)))))))
                 (when (and (or terminal (eq mode t)) (not (equal now shown)))
                   (setq shown now)
                   (show (format nil "integrate_motion: ~a, ~d %" what (second now))))))
             (when (and shown (null what)) (show "")))))))

(maxima::defmfun maxima::$anmech_motion (model states interval parameters accuracy verify max-steps progress)
  "anmech_motion(model, states, [t0, t1], parameters, accuracy, verify, max_steps, progress): all numbers exact."
  (let* ((exact (mapcar #'exact-value (append (rest states) (list (second interval)) (rest parameters))))
         (nearest (mapcar #'to-double exact))
         (other (mapcar #'neighbour nearest exact))
         (place (length (rest states))))
    (setf (nth place other) (nth place nearest))      ; one and the same first time
    (let ((line (progress-line progress))
          (end (to-double (exact-value (third interval)))))
      (unwind-protect (integrate-motion model (doubles nearest) (doubles other) end
                                        (to-double (exact-value accuracy)) verify max-steps line)
        (when line (funcall line))))))
