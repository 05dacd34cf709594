;;; anmech: integration by a discrete Pfaff-Birkhoff principle.
;;;
;;; It registers itself as method = pfaff.  Entry point: $anmech_pfaff_scheme.
;;;
;;; A step is a symmetric map, made of stages that are midpoint rules of different lengths.  A scheme says what a
;;; stage is.  Its state s is m positions q and k momenta p; its unknowns x are m + k + g numbers: the values in the
;;; middle of the stage of q, and of k variables y on which the momenta depend, and the multipliers of g constraints.
;;; With half the length of the stage, h/2, with d = q_middle - q and the time in the middle, the equations of a
;;; stage are
;;;
;;;   E(t, x, d, h/2) = 0  (m + g of them),   P(t, x, d, h/2) - p - f(t, x, d, h/2) = 0  (k of them),
;;;
;;; and it ends with  q + 2 d, p + 2 f.  There y, and some of the multipliers, are solutions of equations
;;;
;;;   P'(t, x) - p = 0  (k of them),   C(t, x) = 0.
;;;
;;; They are only solved where somebody wants to see y.  Which E, P, f, P', C belong to a Birkhoff system, and what they
;;; preserve, is told in motion/pfaff.mac; here they are compiled functions.
;;;
;;; Newton's method starts from the polynomial through the solutions of the same stage of the last four steps.  The
;;; matrix is that of the derivatives as long as the corrections fade fast.  They are followed down to rounding, so
;;; that what remains of them has no direction: an error that always has the same sign would show as a drift after a
;;; million steps.
;;;
;;; Nothing is kept of most steps.  A state between is computed again from the last one that was kept, by whole steps
;;; and one that is shorter; so the values between are as accurate as the others.
;;;
;;; Literature: L. Kong, H. Wu, F. Mei, Structure-preserving algorithms for Birkhoffian systems, J. Geom. Phys. 62
;;; (2012) 1157; C. L. Ellison, J. M. Finn, J. W. Burby, M. Kraus, H. Qin, W. M. Tang, Degenerate variational
;;; integrators for magnetic field line flow and guiding center trajectories, Phys. Plasmas 25 (2018) 052502;
;;; E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed. 2006, V.3.2 (compositions) and VIII.6
;;; (Newton's method).  Composition of order 4: M. Suzuki, Phys. Lett. A 146 (1990) 319; of order 6: W. Kahan,
;;; R.-C. Li, Math. Comput. 66 (1997) 1089.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats" "arithmetic/linear" "numerics/codegen" "numerics/dag" "numerics/equal_steps"
       "numerics/methods" "numerics/motion" "numerics/progress")

;;; Schemes

(defstruct (scheme (:print-function print-dots))
  (m 0 :type fixnum)
  (k 0 :type fixnum)
  (g 0 :type fixnum)
  (ends 0 :type fixnum)     ; how many are P' and C
  places            ; the place among the states of the system of each unknown but the multipliers
  residual          ; function (in out): E, P, f
  derivatives       ; function (in out): those of (E, P - p - f) by the unknowns, by rows
  momenta           ; function (in out): P' and C, and their derivatives by y and multipliers; nil without momenta
  seconds)          ; what compiling took, until a motion tells of it

(maxima::defmfun maxima::$anmech_pfaff_scheme (places unknowns time parameters middle residual derivatives momenta)
  "anmech_pfaff_scheme(places, unknowns, time, parameters, middle, residual, derivatives, momenta): MIDDLE are symbols
for the increments d and half the length of the stage; RESIDUAL lists E, P, f; MOMENTA lists P', C and their
derivatives."
  (let* ((start (get-internal-real-time))
         (m (- (length middle) 2))
         (variables (length (rest places)))
         (inputs (append (rest unknowns) (list time) (rest parameters))))
    (flet ((compiled (expressions inputs)
             (with-compilation-errors (lambda () (values (compile-expressions expressions inputs))))))
      (make-scheme :m m :k (- variables m) :g (- (length (rest unknowns)) variables)
                   :ends (isqrt (length (rest momenta)))      ; w equations and their w^2 derivatives
                   :places (mapcar #'1- (rest places))
                   :residual (compiled (rest residual) (append inputs (rest middle)))
                   :derivatives (compiled (rest derivatives) (append inputs (rest middle)))
                   :momenta (and (rest momenta) (compiled (rest momenta) inputs))
                   :seconds (seconds-since start)))))

;;; Compositions

(defun symmetric-stages (half middle)
  "The stages HALF, MIDDLE, HALF backwards."
  (append half (list middle) (reverse half)))

(defparameter *compositions*
  (list (list 2 1d0)
        (cons 4 (let ((part (/ (- 4d0 (expt 4d0 (/ 1d0 3d0))))))
                  (symmetric-stages (list part part) (- 1d0 (* 4d0 part)))))
        (cons 6 (symmetric-stages '(0.39216144400731413928d0 0.33259913678935943860d0 -0.70624617255763935981d0
                                    0.082213596293550800231d0)
                                  0.79854399093482996340d0)))
  "For each order, the lengths of the stages of a step of length 1.")

;;; What a run keeps

(defconstant +memory+ 4 "How many steps the first guess of a stage is made from.")

(defstruct (stepper (:print-function print-dots))
  scheme
  (n 0 :type fixnum)                     ; m + k + g
  (state nil :type double-array)         ; q and p
  (before nil :type double-array)        ; the same at the beginning of the step
  (in nil :type double-array)            ; unknowns, time, parameters, increments, half the length of the stage
  (out nil :type double-array)           ; E, P, f; or the momenta and their derivatives
  (right nil :type double-array)         ; right sides, then corrections
  (scales nil :type double-array)        ; the sizes of the unknowns
  (work nil :type double-array)          ; a matrix and what solving with it takes
  (rows nil :type double-array)
  (matrices nil :type simple-vector)     ; one of derivatives for each stage
  (memory nil :type simple-vector)       ; for each stage, its last solutions
  (remembered 0 :type fixnum)            ; how many steps are remembered
  (taken 0 :type fixnum)                 ; how many steps were taken
  (lengths nil :type double-array)       ; of the stages of a step of length 1
  (control nil :type double-array)       ; the length of a step, the time, the size of the last correction
  (evaluations 0 :type fixnum))

(defmacro with-stepper ((stepper) &body body)
  `(with-fast-arithmetic
     (let* ((n (stepper-n ,stepper)) (m (scheme-m (stepper-scheme ,stepper))) (k (scheme-k (stepper-scheme ,stepper)))
            (variables (fix (+ m k))) (conditions (fix (- n k)))      ; of them are E
            (state (stepper-state ,stepper)) (in (stepper-in ,stepper)) (out (stepper-out ,stepper))
            (right (stepper-right ,stepper)) (scales (stepper-scales ,stepper)) (work (stepper-work ,stepper))
            (rows (stepper-rows ,stepper)) (control (stepper-control ,stepper))
            (increments (the fixnum (- (the fixnum (length in)) (fix (+ m 1))))))
       (declare (fixnum n m k variables conditions increments)
                (ignorable n m k variables conditions state in out right scales work rows control increments)
                (type (simple-array double-float (*)) state in out right scales work rows control))
       (macrolet ((control (quantity) `(aref control ,(position quantity '(step time correction)))))
         ,@body))))

(defun make-scheme-stepper (scheme start order step)
  "START holds the states of the system, the time and parameters."
  (flet ((doubles (size) (make-array size :element-type 'double-float :initial-element 0d0)))
    (let* ((m (scheme-m scheme)) (k (scheme-k scheme)) (g (scheme-g scheme)) (ends (scheme-ends scheme)) (n (+ m k g))
           (lengths (coerce (rest (assoc order *compositions*)) 'double-array))
           (stages (length lengths))
           (stepper (make-stepper
                     :scheme scheme :n n :state (doubles (+ m k)) :before (doubles (+ m k))
                     :in (doubles (+ (length start) g m 1))
                     :out (doubles (max (+ n k) (* ends (1+ ends)))) :right (doubles n) :scales (doubles n)
                     :work (doubles (* n n)) :rows (doubles n) :lengths lengths :control (doubles 3)
                     :matrices (coerce (loop repeat stages collect (doubles (* n n))) 'simple-vector)
                     :memory (coerce (loop repeat stages collect (doubles (* +memory+ n))) 'simple-vector))))
      (replace (stepper-in stepper) start :start1 n :start2 (+ m k))
      (setf (aref (stepper-control stepper) 0) step)
      stepper)))

(defun place-stepper (stepper states time)
  "Begin anew at STATES, in the order of the system."
  (let* ((scheme (stepper-scheme stepper)) (n (stepper-n stepper)) (m (scheme-m scheme)) (in (stepper-in stepper))
         (variables (+ m (scheme-k scheme))))
    (fill in 0d0 :start variables :end n)
    (loop for place in (scheme-places scheme)
          for i from 0
          do (setf (aref in i) (aref states place)))
    (setf (aref in n) time
          (aref (stepper-control stepper) 1) time
          (stepper-remembered stepper) 0)
    (first-scales stepper states)
    (when (scheme-momenta scheme)
      (funcall (the function (scheme-momenta scheme)) in (stepper-out stepper)))
    (dotimes (i variables)
      (setf (aref (stepper-state stepper) i) (if (< i m) (aref in i) (aref (stepper-out stepper) (- i m)))))
    stepper))

(defun first-scales (stepper start)
  "A variable counts as at least a small part of the largest one."
  (let* ((variables (length (stepper-state stepper)))
         (least (* 1d-6 (loop for i below variables maximize (abs (aref start i))))))
    (dotimes (i variables)
      (setf (aref (stepper-scales stepper) i) (max least (abs (aref (stepper-in stepper) i)) 1d-290)))))

;;; A stage

(defun load-derivatives (stepper stage)
  "Compute the matrix of STAGE at the present unknowns."
  (declare (type stepper stepper) (fixnum stage))
  (incf (stepper-evaluations stepper))
  (funcall (the function (scheme-derivatives (stepper-scheme stepper)))
           (stepper-in stepper) (svref (stepper-matrices stepper) stage))
  nil)

(defun correct-unknowns (stepper stage)
  "One correction of Newton's method; its size, in units of the scales, goes to control.  Nil if the matrix is singular.
The multipliers do not count: what they do is seen in the variables, and some may be zero but for rounding."
  (declare (type stepper stepper) (fixnum stage))
  (incf (stepper-evaluations stepper))
  (with-stepper (stepper)
    (let ((matrix (svref (stepper-matrices stepper) stage)) (largest 0d0))
      (declare (type (simple-array double-float (*)) matrix) (double-float largest))
      (for (i m) (setf (aref in (fix (+ increments i))) (flo (- (aref in i) (aref state i)))))
      (funcall (the function (scheme-residual (stepper-scheme stepper))) in out)
      (for (i conditions) (setf (aref right i) (flo (- (aref out i)))))
      (for (i k)
        (let ((row (fix (+ conditions i))))
          (declare (fixnum row))
          (setf (aref right row) (flo (- (+ (aref state (fix (+ m i))) (aref out (fix (+ row k)))) (aref out row))))))
      (for (i (fix (* n n))) (setf (aref work i) (aref matrix i)))
      (unless (solve-scaled n work right 0 rows)
        (return-from correct-unknowns nil))
      (for (i n variables) (setf (aref in i) (flo (+ (aref in i) (aref right i)))))
      (for (i variables)
        (let* ((value (flo (+ (aref in i) (aref right i))))
               (scale (flo (max (aref scales i) (abs value))))
               (part (flo (/ (abs (aref right i)) scale))))
          (declare (double-float value scale part))
          (setf (aref in i) value)
          (unless (<= part largest) (setq largest part))))          ; also if it is no number
      (setf (control correction) largest)
      t)))

(defun rounding-left-p (stepper)
  "Whether the last corrections are so small that they may be rounding: of an unknown near zero, that of the larger
ones."
  (declare (type stepper stepper))
  (with-stepper (stepper)
    (let ((least 0d0))
      (declare (double-float least))
      (for (i variables) (setq least (flo (max least (* 1d-6 (aref scales i))))))
      (for (i variables)
        (unless (< (flo (abs (aref right i))) (flo (* 1d-9 (max least (aref scales i)))))
          (return-from rounding-left-p nil)))
      t)))

(defparameter *most-corrections* 50)

(defun solve-stage (stepper stage fresh)
  "Solve the equations of STAGE from the unknowns guessed; FRESH: compute the derivatives first.  Nil without success."
  (declare (type stepper stepper) (fixnum stage))
  (when fresh (load-derivatives stepper stage))
  (with-stepper (stepper)
    (let ((before 1d300) (rounds 0))
      (declare (double-float before) (fixnum rounds))
      (loop
        (unless (correct-unknowns stepper stage) (return nil))
        (incf rounds)
        (let ((correction (control correction)))
          (declare (double-float correction))
          (cond ((<= correction 3d-16) (return t))           ; at 1e-15, what is left of them would have a direction
                ((not (< correction 1d30)) (return nil))
                ((<= correction (flo (* 0.02d0 before))) (setq fresh nil))
                ((and fresh (>= correction (flo (* 0.25d0 before))) (rounding-left-p stepper)) (return t))
                ((> rounds *most-corrections*) (return nil))
                (t (load-derivatives stepper stage)
                   (setq fresh t)))
          (setq before correction))))))

(defun guess-unknowns (stepper stage)
  "By the polynomial through what is remembered of STAGE; without memory, what stands there."
  (declare (type stepper stepper) (fixnum stage))
  (with-stepper (stepper)
    (let ((memory (svref (stepper-memory stepper) stage)) (count (stepper-remembered stepper)))
      (declare (type (simple-array double-float (*)) memory) (fixnum count))
      (macrolet ((past (j) `(aref memory (fix (+ (* ,j n) i)))))
        (case count
          (0 nil)
          (1 (for (i n) (setf (aref in i) (past 0))))
          (2 (for (i n) (setf (aref in i) (flo (- (* 2d0 (past 0)) (past 1))))))
          (3 (for (i n) (setf (aref in i) (flo (+ (* 3d0 (- (past 0) (past 1))) (past 2))))))
          (t (for (i n)
               (setf (aref in i) (flo (- (+ (* 4d0 (past 0)) (* 4d0 (past 2))) (* 6d0 (past 1)) (past 3))))))))
      nil)))

(defun remember-unknowns (stepper stage)
  (declare (type stepper stepper) (fixnum stage))
  (with-stepper (stepper)
    (let ((memory (svref (stepper-memory stepper) stage)))
      (declare (type (simple-array double-float (*)) memory))
      (do ((j (fix (- (* +memory+ n) 1)) (fix (- j 1))))
          ((< j n))
        (declare (fixnum j))
        (setf (aref memory j) (aref memory (fix (- j n)))))
      (for (i n) (setf (aref memory i) (aref in i)))
      (for (i variables)
        (setf (aref scales i) (flo (max (* 0.99d0 (aref scales i)) (abs (aref in i))))))     ; a motion may fade
      nil)))

(defun take-step (stepper)
  "Advance the state by a step; nil, without having done so, if the equations of a stage could not be solved."
  (declare (type stepper stepper))
  (with-stepper (stepper)
    (let ((lengths (stepper-lengths stepper)) (now (control time)) (fresh (< (stepper-remembered stepper) +memory+)))
      (declare (type (simple-array double-float (*)) lengths) (double-float now))
      (for (stage (length lengths))
        (let ((half (flo (* 0.5d0 (* (control step) (aref lengths stage))))))
          (declare (double-float half))
          (guess-unknowns stepper stage)
          (setf (aref in n) (flo (+ now half))
                (aref in (fix (+ increments m))) half)
          (unless (or (solve-stage stepper stage fresh)
                      (and (not fresh) (progn (guess-unknowns stepper stage) (solve-stage stepper stage t))))
            (return-from take-step nil))
          (for (i m) (setf (aref state i) (flo (+ (aref state i) (* 2d0 (- (aref in i) (aref state i)))))))
          (for (i k)
            (setf (aref state (fix (+ m i)))
                  (flo (+ (aref state (fix (+ m i))) (* 2d0 (aref out (fix (+ conditions k i))))))))
          (setq now (flo (+ now (* 2d0 half))))
          (remember-unknowns stepper stage)))
      (setf (control time) now)
      (when (< (stepper-remembered stepper) +memory+) (incf (stepper-remembered stepper)))
      t)))

;;; States of the system

(defun momenta-correction (stepper)
  "Correct y and multipliers, among the unknowns, so that the momenta are those of the state: the size of the
correction of y, nil if that fails."
  (with-stepper (stepper)
    (let ((ends (scheme-ends (stepper-scheme stepper))))
      (declare (fixnum ends))
      (funcall (the function (scheme-momenta (stepper-scheme stepper))) in out)
      (for (i ends) (setf (aref right i) (flo (- (if (< i k) (aref state (fix (+ m i))) 0d0) (aref out i)))))
      (for (i (fix (* ends ends))) (setf (aref work i) (aref out (fix (+ ends i)))))
      (and (solve-scaled ends work right 0 rows)
           (let ((largest 0d0))
             (declare (double-float largest))
             (for (i ends)
               (setf (aref in (fix (+ m i))) (flo (+ (aref in (fix (+ m i))) (aref right i)))))
             (for (i k)
               (let ((part (flo (/ (abs (aref right i)) (aref scales (fix (+ m i)))))))
                 (declare (double-float part))
                 (unless (<= part largest) (setq largest part))))
             largest)))))

(defun states-of (stepper states)
  "Write the states of the system, in its order, to STATES.  Nil if y could not be found."
  (let* ((scheme (stepper-scheme stepper)) (in (stepper-in stepper)) (n (stepper-n stepper)))
    (replace in (stepper-state stepper) :end1 (scheme-m scheme))
    (fill in 0d0 :start (length (stepper-state stepper)) :end n)
    (setf (aref in n) (aref (stepper-control stepper) 1))
    (when (or (null (scheme-momenta scheme))
              (loop for before = 1d300 then correction
                    for correction = (momenta-correction stepper)
                    repeat *most-corrections*
                    do (cond ((or (null correction) (not (< correction 1d30))) (return nil))
                             ((or (<= correction 1d-15) (and (< correction 1d-9) (>= correction (* 0.25d0 before))))
                              (return t)))))
      (loop for place in (scheme-places scheme)
            for i from 0
            do (setf (aref states place) (aref in i)))
      states)))

;;; Steps of equal length

(defun take-steps (stepper count t0 step)
  "Go on until COUNT steps are taken since the time T0.  Nil, or what has prevented it: a condition, or :unsolved."
  (declare (type stepper stepper) (fixnum count) (double-float t0 step))
  (let ((state (stepper-state stepper)) (before (stepper-before stepper)) (control (stepper-control stepper)))
    (declare (type (simple-array double-float (*)) state before control))
    (handler-case
        (loop while (< (stepper-taken stepper) count)
              do (setf (aref control 1) (+ t0 (* step (stepper-taken stepper))))
                 (replace before state)
                 (unless (take-step stepper) (return :unsolved))
                 (incf (stepper-taken stepper)))
      ((or domain-violation arithmetic-error) (condition) condition))))

(defun advance-stepper (stepper count t0 step)
  "TAKE-STEPS; a step whose first guess has led astray is tried again with a more careful one."
  (loop
    (let ((trouble (take-steps stepper count t0 step)))
      (when (or (null trouble) (<= (stepper-remembered stepper) 1))
        (return trouble))
      (replace (stepper-state stepper) (stepper-before stepper))
      (setf (stepper-remembered stepper) 1))))

(defun place-safely (stepper states time)
  "PLACE-STEPPER; a condition instead of an error."
  (handler-case (progn (place-stepper stepper states time) nil)
    ((or domain-violation arithmetic-error) (condition) condition)))

(defun pfaff-walker (scheme start order step)
  "What takes steps of the length STEP from START (equal_steps.lisp)."
  (let* ((t0 (aref start (length (scheme-places scheme))))
         (stepper (make-scheme-stepper scheme start order step)))
    (make-walker :trouble (place-safely stepper start t0)
                 :advance (lambda (count) (advance-stepper stepper count t0 step))
                 :taken (lambda () (stepper-taken stepper))
                 :state (lambda (time out) (states-at stepper time out))
                 :cost (lambda () (stepper-evaluations stepper))
                 :value (lambda (states time later out) (pfaff-value scheme start order step states time later out)))))

(defun states-at (stepper time out)
  "The states of the system after the steps that were taken, which is at TIME."
  (setf (aref (stepper-control stepper) 1) time)
  (states-of stepper out))

(defun pfaff-value (scheme start order step states time later out)
  "The states at LATER, by steps from STATES at TIME on; the last one is as short as need be."
  (let ((count (max 0 (floor (* (- later time) (+ 1d0 1d-13)) step))) (found (copy-seq states)))
    (flet ((go-on (from count step)
             (let ((stepper (make-scheme-stepper scheme start order step)))
               (and (null (or (place-safely stepper found from)
                              (advance-stepper stepper count from step)))
                    (states-at stepper (+ from (* count step)) found)))))
      (unless (and (or (zerop count) (go-on time count step))
                   (let* ((from (+ time (* count step))) (left (- later from)))
                     (or (< (abs left) (* 1d-12 (abs step)))
                         (go-on from 1 left))))
        (complain "the equations of a step before time ~a were not solved" (maxima-text later)))
      (replace out found))))

;;; The method

(defun order-of-pfaff (options)
  (let ((given (assoc 'maxima::$order options))) (if given (cdr given) 2)))

(defun trouble-of-pfaff (options)
  "What is wrong with its options: a sentence, or nil."
  (let ((order (order-of-pfaff options)))
    (if (assoc order *compositions*)
        (step-size-trouble "pfaff" options)
        (format nil "order must be ~a, found ~a" (enumeration (mapcar #'first *compositions*) "or") (one-line order)))))

(defun pfaff-motion (task)
  (let* ((scheme (task-prepared task))
         (order (order-of-pfaff (task-options task)))
         (motion (motion-of-equal-steps task (lambda (problem start step)
                                               (declare (ignore problem))
                                               (pfaff-walker scheme start order step)))))
    (setf (motion-compile-seconds motion) (scheme-seconds scheme)
          (scheme-seconds scheme) 0d0)
    motion))

(register-integrator "pfaff"
                     :kinds '("birkhoff_system")
                     :advice "to_birkhoff finds one for many"
                     :all-states t
                     :options '("step_size" "order")
                     :check #'trouble-of-pfaff
                     :preserves '("two_form")
                     :module "motion/pfaff"
                     :function "anmech_pfaff_prepared"
                     :run #'pfaff-motion)
