;;; anmech: Taylor's method, of an order that the accuracy asks for, up to 24, with dense output by the polynomials.
;;;
;;; It registers itself as method = taylor; with more digits than doubles have it leaves the motion to
;;; long_motion.lisp, and with rigorous = true to enclosed_motion.lisp.  The coefficients of a step come from the
;;; model's series program (series_program.lisp), by recursion, not from values of the field: so the cost of a step
;;; grows with the order, its length hardly changes, and the error falls exponentially.  The step is that of A. Jorba
;;; and M. Zou: its last two terms are as large as the tolerance allows.  The order, theirs is 1 - ln(tolerance)/2, is
;;; higher: where the products are few, a step costs by far less than the square of its order.  Errors are larger parts
;;; of the tolerance then, so that tolerances are finer.
;;;
;;; While a motion slides along a surface, or rests, its rates are no formula of the equations (switching.lisp): such
;;; pieces are left to the method of dop853.lisp.  So are single steps where there is no power series, as where what a
;;; root is taken of vanishes, and near there, as long as that method's steps are longer; a table says which these are,
;;; for who takes steps again.
;;;
;;; The last terms of a series need not tell what follows them: of a bump far away it has nothing yet, or terms that
;;; still grow.  So where a step ends, within one that is longer than those before, and where what an exponential is
;;; taken of is largest within it, the rates of the polynomials are compared with those of the equations; where they
;;; part, the step is taken again, and shorter.
;;;
;;; What is kept of a step is an array: of each state the coefficients, as they stand in the kernel's, then the time
;;; and its unit.
;;;
;;; Literature: A. Jorba, M. Zou, A software package for the numerical integration of ODEs by means of high-order Taylor
;;; methods, Experimental Mathematics 14 (2005) 99-117.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats" "numerics/accuracy" "numerics/arrangement" "numerics/enclosed_motion"
       "numerics/integration" "numerics/long_motion" "numerics/methods" "numerics/model" "numerics/motion"
       "numerics/motions_in_lanes"
       "numerics/passes" "numerics/series_code" "numerics/series_kernel" "numerics/series_program" "numerics/steps"
       "numerics/watching" "numerics/integrators/dop853")

(defparameter *least-order* 4)

(defparameter *few-sums* 7 "So many sums of products in a series program are few.")
(defparameter *order-of-few* 0.7d0 "Their order in units of -ln(tolerance), by which motions cost least.")
(defparameter *order-of-many* 0.6d0 "The same of more.")
(defparameter *order-of-steep* 0.5d0 "The same where functions are taken that may be steep.")

(defun order-for (tolerance part)
  "That of the steps for a relative TOLERANCE; PART: in units of -ln(tolerance)."
  (max (the fixnum *least-order*) (min (- +room+ 1) (ceiling (- 1 (* part (log tolerance)))))))

(defstruct taylor-work
  (kernel nil :type series-kernel)
  (order 0 :type fixnum)
  (here nil :type double-array)           ; what the kernel works on: of the step that begins where the run is
  (there nil :type double-array)          ; of the next one
  (numbers nil :type double-array)        ; see NOTED
  (fresh nil)                             ; whether HERE is of the present state
  (factors nil)                           ; those of the noise in linear equations
  (roots '())                             ; the numbers of the instructions that are roots
  (steep '())                              ; the series of which functions are taken that may be steep
  (seed 1 :type fixnum)
  (stages nil)                            ; what DOP853 works on
  (table nil)                             ; of the times where steps by stages begin
  (staged nil)                            ; whether the step that is being taken is one
  (rates-known nil)                       ; whether the first of the stages is that of the present state
  (probing nil)                           ; whether to try a step by stages that is longer than the series allow
  (longest 0d0 :type double-float)        ; the longest step by series so far
  (last 0d0 :type double-float)           ; the last one
  (probed 1d300 :type double-float)       ; how long it was when stages were tried last
  (series-exponent 0d0 :type double-float)   ; by which steps are chosen
  (seen nil :type double-array)           ; what the field sees
  (slopes nil :type double-array)         ; of the polynomials there, by the unit of time
  (rates nil :type double-array)          ; what it gives
  (other-rates nil :type double-array))

(defmacro noted (expansion quantity)
  "A number of EXPANSION; they stand in an array, unboxed.  LONGEST is the longest step, and UNIT the unit of time, of
HERE; NEXT-LONGEST and NEXT-UNIT are those of the expansion that is being made, NEXT-TIME is the time there.  DEFECT:
see below."
  `(aref (the (simple-array double-float (*)) (taylor-work-numbers ,expansion))
         ,(position quantity '(longest unit next-longest next-unit next-time defect))))

;;; Coefficients

(defun factors-for (kernel noise)
  "By what entries of linear equations are changed: a unit in the last place, as states are by NOISE."
  (let ((linear (series-kernel-linear kernel)))
    (when (and noise linear)
      (let ((entries (linear-kernel-entries linear))
            (direction (if (> (aref (the double-array noise) 0) 1d0) 1 -1)))
        (coerce (loop for place from 0 below (length entries) by 4
                      collect (+ 1d0 (* 2.3d-16 direction
                                        (chessboard-sign (aref entries place) (aref entries (1+ place))))))
                'double-array)))))

(defun new-taylor-work (run table)
  (let ((model (problem-model (run-problem run))) (n (run-n run)))
    (let ((kernel (model-kernel model)))
      (make-taylor-work :kernel kernel :order (1- (formula-order (run-formula run))) :table table
                        :series-exponent (with-control (run) (control exponent))
                        :seen (copy-seq (run-in run)) :slopes (zeros n) :rates (zeros n) :other-rates (zeros n)
                        :here (zeros (series-kernel-size kernel))
                        :there (zeros (series-kernel-size kernel)) :numbers (zeros 6)
                        :factors (factors-for kernel (problem-noise (run-problem run)))))))

(defun model-kernel (model)
  (let ((series (model-series-program model)))
    (or (cdr (assoc :doubles (series-program-kernels series)))
        (let ((kernel (new-kernel series)))
          (push (cons :doubles kernel) (series-program-kernels series))
          kernel))))

(defun place-states (run expansion work states)
  "Write STATES and their time to WORK, as roundings may have changed them in the second of two integrations."
  (declare (type (simple-array double-float (*)) work states))
  (let ((noise (problem-noise (run-problem run))) (n (run-n run)) (at-time (* +room+ (the fixnum (run-n run))))
        (time (noted expansion next-time)))
    (declare (fixnum n at-time) (double-float time))
    (with-fast-arithmetic
      (cond (noise
             (let ((noise noise) (seed (taylor-work-seed expansion)))
               (declare (type (simple-array double-float (*)) noise) (fixnum seed))
               (for (i n) (setf (aref work (fix (* +room+ i))) (flo (* (aref noise i) (aref states i)))))
               (setq seed (the fixnum (logand 65535 (the fixnum (+ 13849 (the fixnum (* 25173 seed)))))))
               (setf (taylor-work-seed expansion) seed)
               (setf (aref work at-time)
                     (flo (* time (+ 1d0 (if (< seed 22000) -2.3d-16 (if (< seed 44000) 0d0 2.3d-16))))))))
            (t (for (i n) (setf (aref work (fix (* +room+ i))) (aref states i)))
               (setf (aref work at-time) time)))
      nil)))

(defun restore-states (work states n)
  "Write STATES, as they are, to WORK: there begins the step."
  (declare (type (simple-array double-float (*)) work states) (fixnum n))
  (with-fast-arithmetic
    (for (i n) (setf (aref work (fix (* +room+ i))) (aref states i)))
    nil))

(defun expand-at (run expansion work states)
  "The coefficients at STATES and NEXT-TIME, by NEXT-UNIT, go to WORK; NEXT-LONGEST becomes the longest step there.
Nil where there is no power series, :TOO-LARGE where coefficients are no numbers."
  (declare (type (simple-array double-float (*)) work))
  (let ((kernel (taylor-work-kernel expansion)) (order (taylor-work-order expansion)))
    (incf (run-evaluations run) order)
    (with-fast-arithmetic
      (unless (= (noted expansion next-unit) (unit-placed kernel work))
        (place-unit kernel work (noted expansion next-unit))))
    (place-states run expansion work states)
    (trapped-as :too-large
                (when (expand-series kernel work order (taylor-work-factors expansion))
                  (when (problem-noise (run-problem run)) (restore-states work states (run-n run)))
                  (if (find-longest run expansion work order) t :too-large)))))

(defmacro largest-of-order (run work k)
  "The largest coefficient of order K in units of the tolerance, WITH-CONTROL; a function would box it."
  `(let ((absolute (run-absolute ,run)) (relative (control relative)) (order ,k) (worst 0d0))
     (declare (type (simple-array double-float (*)) absolute) (double-float relative worst) (fixnum order))
     (for (i (run-n ,run))
       (let* ((place (fix (* +room+ i)))
              (unit (flo (max (+ (aref absolute i) (* relative (abs (aref ,work place)))) +least-unit+)))
              (size (flo (/ (abs (aref ,work (fix (+ place order)))) unit))))
         (declare (fixnum place) (double-float unit size))
         (cond ((not (< size 1d290)) (setq worst 1d300))           ; what is no number is none that others exceed
               ((> size worst) (setq worst size)))))
     worst))

(defmacro growth-of-term (size order)
  "The logarithm of the root of SIZE; that of 1e-30 where it comes to nothing."
  `(let ((size ,size) (order ,order))
     (declare (double-float size) (fixnum order))
     (if (> size 1d-290) (flo (/ (natural-log size) (+ 0d0 order))) -69d0)))

(defun find-longest (run expansion work order)
  "NEXT-LONGEST becomes the step in which the last two terms are as large as they may be: the tolerance, and a seventh
of it.  Where steps are taken again, none is too long.  Nil where these terms are no numbers."
  (declare (type (simple-array double-float (*)) work) (fixnum order))
  (with-control (run)
    (if (= 0d0 (control relative))
        (progn (setf (noted expansion next-longest) 1d300) t)
        (let ((last (largest-of-order run work order)) (before (largest-of-order run work (fix (- order 1)))))
          (declare (double-float last before))
          (when (and (< last 1d290) (< before 1d290))
            (setf (noted expansion next-longest)
                  (flo (* (noted expansion next-unit)
                          (natural-exp (flo (- (max (growth-of-term (flo (* 7.4d0 last)) order)
                                                    (growth-of-term before (fix (- order 1))))))))))
            t)))))

;;; The formula

(defun plain-p (run)
  "Whether the rates are those of the equations, on the sides where the run is."
  (let ((watcher (run-watcher run)))
    (or (null watcher) (not (or (watcher-sliding watcher) (watcher-resting watcher))))))

(defun by-stages (run function)
  "FUNCTION of RUN, of the formula of dop853.lisp."
  (let ((expansion (run-work run)))
    (setf (run-work run) (taylor-work-stages expansion))
    (unwind-protect (funcall (the function function) run)
      (setf (taylor-work-stages expansion) (run-work run)
            (run-work run) expansion))))

(defun taken-again-p (run)
  "Whether RUN takes the steps of another one again."
  (zerop (the fixnum (run-max-steps run))))

(defun begin-taylor (run table)
  (unless (run-work run) (setf (run-work run) (new-taylor-work run table)))
  (let ((expansion (run-work run)))
    (setf (taylor-work-fresh expansion) nil
          (taylor-work-rates-known expansion) nil)
    (replace (taylor-work-seen expansion) (run-in run))
    (cond ((plain-p run)
           (let ((kernel (taylor-work-kernel expansion)))
             (place-constants kernel (run-in run) (taylor-work-here expansion) (taylor-work-there expansion))
             (setf (taylor-work-roots expansion) (root-instructions kernel (taylor-work-here expansion))
                   (taylor-work-steep expansion) (steep-arguments kernel))
             (cond ((expanded-p run expansion)
                    (with-control (run)
                      (setf (control step)
                            (flo (* (control direction)
                                    (min (control longest) (noted expansion longest))
                                    (the double-float (if (problem-noise (run-problem run)) 0.6d0 1d0))))))
                    nil)
                   (t (begin-stages run expansion)))))
          (t (by-stages run #'begin-dop853)))))

(defun expanded-p (run expansion)
  "Whether there are power series where the run is; they are computed, unless they are known."
  (or (taylor-work-fresh expansion)
      (handler-case (expand-first run expansion)
        ((or domain-violation arithmetic-error) () nil))))

(defun begin-stages (run expansion)
  "The rates where the run is."
  (place-state run)
  (prog1 (by-stages run #'begin-dop853)
    (setf (taylor-work-rates-known expansion) t
          (taylor-work-staged expansion) t)))

(defun expand-first (run expansion)
  "The coefficients where the run is, and the longest step.  Nothing is known of the unit of time: it is the time in
which a state changes by its size, and made smaller until no coefficient overflows.  Nil where there are none."
  (let ((unit (first-unit run)) (here (taylor-work-here expansion)) (outcome nil))
    (with-control (run) (setf (noted expansion next-time) (control time)))
    (loop repeat 12
          do (setf (noted expansion next-unit) unit
                   outcome (expand-at run expansion here (run-state run)))
          while (and (eq outcome :too-large) (not (value-overflows-p (taylor-work-kernel expansion) here)))
          do (setq unit (* unit 1d-6)))
    (when (eq outcome t)
      (setf (noted expansion longest) (min (noted expansion next-longest)
                                           (first-limit run here unit (taylor-work-order expansion)))
            (noted expansion unit) unit
            (taylor-work-fresh expansion) t))))

(defun value-overflows-p (kernel work)
  "Whether a coefficient of order 0 in WORK is too large for a double, as cosh(t)^2 in 1/cosh(t)^2 may be: then no unit
of time is small enough."
  (loop for place from 0 below (series-kernel-unknowns kernel) by +room+
        thereis (not (<= (abs (aref (the double-array work) place)) most-positive-double-float))))

(defun near-power (size)
  "A power of two near the double SIZE."
  (scale-float 1d0 (max -900 (min 900 (nth-value 1 (decode-float size))))))

(defun first-unit (run)
  "About the time in which states change by their sizes, which are not less than the error that they may have: of what
has nearly died out, a polynomial in a minute unit would overflow."
  (let ((rates (zeros (run-n run))) (absolute (run-absolute run)))
    (declare (type (simple-array double-float (*)) rates absolute))
    (funcall (the function (run-field run)) (run-in run) rates)
    (incf (run-evaluations run))
    (with-control (run)
      (let ((size (control longest)) (state (run-state run)))
        (declare (double-float size) (type (simple-array double-float (*)) state))
        (for (i (run-n run))
          (let ((rate (flo (abs (aref rates i)))) (there (flo (abs (aref state i)))))
            (declare (double-float rate there))
            (when (and (> rate 1d-250) (> there 1d-250) (or (> rate 1d0) (< there 1d50)))
              (setq size (flo (min size (/ (max there (aref absolute i)) rate)))))))
        (near-power size)))))

(defun first-limit (run work unit order)
  "No longer than ten times what the coefficients of lower orders let expect of the radius of convergence: a first step
has no other before it."
  (let ((relative (with-control (run) (control relative))))
    (if (zerop relative)
        1d300
        (* 10d0 unit (natural-exp (- (the double-float (growth-of-terms run work order relative))))))))

(defun growth-of-terms (run work order part)
  "The largest that PART of the coefficients up to ORDER show."
  (declare (type (simple-array double-float (*)) work) (fixnum order) (double-float part))
  (with-control (run)
    (let ((most -69d0))
      (declare (double-float most))
      (for (before order)
        (let ((k (fix (+ before 1))))
          (declare (fixnum k))
          (setq most (flo (max most (growth-of-term (flo (* part (largest-of-order run work k))) k))))))
      most)))

(defmacro polynomial-at (array place order argument)
  "The value of the polynomial of ORDER, at least 2, whose coefficients stand in ARRAY from PLACE on; its odd and even
terms are two chains that a processor computes at the same time, and the first one is added last."
  `(let ((place ,place) (k ,order) (x ,argument) (one 0d0) (other 0d0))
     (declare (fixnum place k) (double-float x one other))
     (let ((square (flo (* x x))))
       (declare (double-float square))
       (loop
         (setq one (flo (+ (aref ,array (fix (+ place k))) (* square one)))
               other (flo (+ (aref ,array (fix (+ place k -1))) (* square other)))
               k (fix (- k 2)))
         (when (< k 2) (return)))
       (when (= k 1)
         (setq x (flo (* x (+ (aref ,array (fix (+ place 1))) (* square one)))) one other other 1d0))
       (flo (+ (aref ,array place) (+ (* square one) (* x other)))))))

(defmacro with-polynomial ((value slope) (array place order argument) &body body)
  "BODY with the VALUE of the same, and its derivative, the SLOPE."
  `(let ((,value 0d0) (,slope 0d0))
     (declare (double-float ,value ,slope))
     (let ((place ,place) (k ,order) (x ,argument) (odd 0d0) (even 0d0) (odd-slope 0d0) (even-slope 0d0))
       (declare (fixnum place k) (double-float x odd even odd-slope even-slope))
       (let ((square (flo (* x x))))
         (declare (double-float square))
         (unless (logtest 1 k)
           (setq even (aref ,array (fix (+ place k))) k (fix (- k 1))))
         (loop
           (setq odd-slope (flo (+ odd (* square odd-slope)))
                 odd (flo (+ (aref ,array (fix (+ place k))) (* square odd)))
                 k (fix (- k 2)))
           (when (< k 1) (return))
           (setq even-slope (flo (+ even (* square even-slope)))
                 even (flo (+ (aref ,array (fix (+ place k 1))) (* square even)))))
         (setq ,value (flo (+ (aref ,array place) (+ (* square even) (* x odd))))
               ,slope (flo (+ odd (* 2d0 (+ (* square odd-slope) (* x (+ even (* square even-slope)))))))))
       nil)
     ,@body))

(defun attempt-taylor (run)
  (declare (type run run))
  (if (plain-p run)
      (let ((expansion (run-work run)))
        (choose-way run expansion)
        (if (taylor-work-staged expansion)
            (attempt-stages run expansion)
            (attempt-series run expansion))
        nil)
      (attempt-by-stages run)))

(defun choose-way (run expansion)
  "Whether the next step is one by stages: where there are no series, or where stages come farther."
  (let ((again (taken-again-p run)) (stages (taylor-work-staged expansion)))
    (setf (taylor-work-staged expansion)
          (if again
              (or (with-control (run) (values (gethash (control time) (taylor-work-table expansion))))
                  (not (expanded-p run expansion)))
              (or (not (expanded-p run expansion))
                  (with-control (run)
                    (let ((step (flo (abs (control step))))
                          (longest (noted expansion longest)))
                      (declare (double-float step longest))
                      (cond ((or stages (taylor-work-probing expansion)) (> step (flo (* 1.02d0 longest))))
                            ;; behind a surface beside which a root vanishes
                            ((taylor-work-roots expansion) (> step (flo (* 3d0 longest))))))))))))

(defparameter *stage-exponent* 0.117d0 "By which steps of dop853.lisp are chosen.")

(defun attempt-by-stages (run)
  "A step by stages.  Those after it are chosen by the order of stages: by that of series, they would shrink for ever."
  (with-control (run) (setf (control exponent) *stage-exponent*))
  (by-stages run #'attempt-dop853))

(defun attempt-stages (run expansion)
  "A step by stages; where it was but to be tried, and is not good, one by series."
  (unless (taylor-work-rates-known expansion) (begin-stages run expansion))
  (if (and (taylor-work-probing expansion) (taylor-work-fresh expansion) (not (taken-again-p run)))
      (let ((good (handler-case (progn (attempt-by-stages run)
                                       (with-control (run) (<= (control error) 1d0)))
                    ((or domain-violation arithmetic-error) () nil))))
        (setf (taylor-work-probing expansion) nil)
        (unless good
          (setf (taylor-work-staged expansion) nil)
          (attempt-series run expansion)))
      (attempt-by-stages run)))

(defun attempt-series (run expansion)
  "A step by series; by stages where a root vanishes on the way."
  (with-control (run)
    (setf (control exponent) (taylor-work-series-exponent expansion))
    (let ((longest (noted expansion longest))
          (again (taken-again-p run)))
      (declare (double-float longest))
      (when (and (> (flo (abs (control step))) (flo (* 1.02d0 longest))) (not again))
        (setf (control step) (flo (- (+ (control time) (* (control direction) longest)) (control time)))))
      (setf (control error) (if (end-of-polynomials run expansion) 0.5d0 1d300))
      (cond (again nil)
            ((root-vanishes-p expansion (flo (/ (control step) (noted expansion unit))))
             (setf (taylor-work-staged expansion) t)
             (attempt-stages run expansion))
            ((< (control error) 1d200)
             (look-at-defects run expansion)
             (setf (control error) (flo (max 0.5d0 (noted expansion defect)))))))
    nil))

;;; The defect

(defconstant +most-defect+ 30d0
  "What the defect may make of a state within the step, in units of the tolerance: a series whose last term is as large
as it may be has one of half a unit, and an error that is by the order smaller.")

(defparameter *places-looked-at* '(0.83d0 0.61d0 0.37d0 0.19d0) "Within steps that are longer than those before.")
(defparameter *longer-than-last* 1.5d0)

(defun look-at-defects (run expansion)
  "DEFECT becomes 1 or less, if the polynomials follow the equations where the step ends as well as they may; more, if
they do not."
  (with-control (run)
    (let ((h (control step)) (last (taylor-work-last expansion)))
      (declare (double-float h last))
      (note-defect-at-end run expansion)
      (when (and (<= (noted expansion defect) 1d0)
                 (> (flo (abs h)) (flo (* (the double-float *longer-than-last*) last))))
        (let ((worst (noted expansion defect)))
          (declare (double-float worst))
          (dolist (place *places-looked-at*)
            (note-defect run expansion (flo (* h (the double-float place))))
            (setq worst (flo (max worst (noted expansion defect)))))
          (setf (noted expansion defect) worst)))
      (dolist (series (taylor-work-steep expansion) nil)
        (unless (<= (noted expansion defect) 1d0) (return))
        (setf (noted expansion defect)
              (flo (max (noted expansion defect) (the double-float (defect-where-steep run expansion series)))))))))

(defparameter *steep* '(:exp :tanh :erf :erfc :sinh :cosh))

(defun steep-arguments (kernel)
  "The places of the series of which the functions *STEEP* are taken."
  (let ((found '()))
    (loop for (operation function series) across (series-kernel-instructions kernel)
          do (when (and (eq operation :primitive) (member function *steep*))
               (pushnew (* +room+ series) found)))
    found))

(defconstant +parts-of-step+ 8)

(defun turn-of-polynomial (work place order part where)
  "Where the polynomial at PLACE turns near WHERE, in units of PART, by parabolas through nearer and nearer values; and
its bend there."
  (declare (fixnum place order) (type (simple-array double-float (*)) work) (double-float part where))
  (with-fast-arithmetic
    (let ((apart 0.25d0) (bend 0d0))
      (declare (double-float apart bend))
      (for (k 3)
        (let* ((a (polynomial-at work place order (flo (* part (- where apart)))))
               (b (polynomial-at work place order (flo (* part where))))
               (c (polynomial-at work place order (flo (* part (+ where apart)))))
               (second (flo (- (- c b) (- b a)))) (across (flo (* 0.5d0 apart (- c a)))))
          (declare (double-float a b c second across))
          (when (< (flo (abs across)) (flo (abs second)))
            (setq where (flo (- where (/ across second)))))
          (setq bend (flo (/ second (* apart apart)))
                apart (flo (* 0.125d0 apart)))))
      (values where bend))))

(defun zero-of-polynomial (work place order part where)
  "Where the polynomial at PLACE vanishes near WHERE, in units of PART."
  (declare (fixnum place order) (type (simple-array double-float (*)) work) (double-float part where))
  (with-fast-arithmetic
    (for (k 3)
      (with-polynomial (value slope) (work place order (flo (* part where)))
        (let ((slope (flo (* slope part))))
          (declare (double-float slope))
          (when (< (flo (abs value)) (flo (abs slope)))
            (setq where (flo (- where (/ value slope))))))))
    where))

(defun defect-where-steep (run expansion place)
  "The largest error of the defect where the series at PLACE, the argument of an exponential for example, is largest or
least within the step, or vanishes: there a bump may be, or a step, of which nothing is to be seen where it begins."
  (declare (fixnum place))
  (let ((work (taylor-work-here expansion)) (order (taylor-work-order expansion)) (worst 0d0))
    (declare (type (simple-array double-float (*)) work) (fixnum order) (double-float worst))
    (with-control (run)
      (let* ((h (control step)) (parts (+ 0d0 +parts-of-step+))
             (part (flo (/ h (* parts (noted expansion unit)))))
             (a 0d0) (b (polynomial-at work place order (flo (- part)))) (c (aref work place)))
        (declare (double-float h parts part a b c))
        (flet ((look (where)
                 (declare (double-float where))
                 (when (and (> where 0d0) (< where parts))
                   (note-defect run expansion (flo (/ (* h where) parts)))
                   (setq worst (flo (max worst (noted expansion defect))))))
               (go-on (now)
                 (declare (double-float now))
                 (let ((argument (flo (* part (+ now 1d0)))))
                   (declare (double-float argument))
                   (setq a b b c c (polynomial-at work place order argument)))
                 nil))
          (for (k (fix (+ +parts-of-step+ 1)))
            (let ((now (flo (+ 0d0 k))))
              (declare (double-float now))
              (go-on now)
              (let* ((before (flo (- b a))) (step (flo (- c b))) (bend (flo (- step before))) (size (flo (abs bend))))
                (declare (double-float before step bend size))
                (cond ((not (< size 1d290)) nil)             ; its numbers tell nothing, but the end of the step will
                      ((and (> size 1d0) (if (> before 0d0) (<= step 0d0) (>= step 0d0)))
                       (multiple-value-bind (where bend)
                           (turn-of-polynomial work place order part (flo (- now (/ (* 0.5d0 (+ before step)) bend))))
                         (declare (double-float where bend))
                         (look where)
                         ;; what changes its sign where the bump is highest
                         (unless (= bend 0d0) (look (flo (+ where (/ 1d0 (sqrt (flo (abs bend)))))))))))
                (when (and (< size 1d290) (if (< b 0d0) (> c 0d0) (< c 0d0)) (> (flo (abs step)) 2d0))
                  (look (zero-of-polynomial work place order part (flo (+ now (/ b (- b c))))))))))))
      worst)))

(defun note-defect (run expansion way)
  "DEFECT becomes that WAY after the beginning of the step."
  (declare (double-float way))
  (let ((work (taylor-work-here expansion)) (order (taylor-work-order expansion)) (seen (taylor-work-seen expansion))
        (slopes (taylor-work-slopes expansion))
        (part (flo (/ way (noted expansion unit)))))
    (declare (type (simple-array double-float (*)) work seen slopes) (fixnum order) (double-float part))
    (with-run (run)
      (for (i n)
        (with-polynomial (value slope) (work (fix (* +room+ i)) order part)
          (setf (aref seen i) value (aref slopes i) slope)))
      (setf (aref seen n) (flo (+ now way)))
      (note-defect-of-point run expansion))))

(defun note-defect-at-end (run expansion)
  "The same where the step ends, as END-OF-POLYNOMIALS has left it."
  (let ((seen (taylor-work-seen expansion)))
    (declare (type (simple-array double-float (*)) seen))
    (with-run (run)
      (for (i n) (setf (aref seen i) (aref next i)))
      (setf (aref seen n) (flo (+ now h)))
      (note-defect-of-point run expansion))))

(defun note-defect-of-point (run expansion)
  "The same where the field sees the state of the polynomials, and their slopes are known.  A large defect may be due to
rounding: what the field gives of states and times changed by some units in the last place tells."
  (let ((seen (taylor-work-seen expansion)))
    (declare (type (simple-array double-float (*)) seen))
    (with-run (run)
      (funcall field seen (taylor-work-rates expansion))
      (incf (run-evaluations run))
      (compare-slopes run expansion nil)
      (unless (<= (noted expansion defect) 1d0)
        (for (i (fix (+ n 1)))
          (setf (aref seen i)
                (flo (* (aref seen i) (the double-float (if (evenp i) +one-above+ +one-below+))))))
        (funcall field seen (taylor-work-other-rates expansion))
        (incf (run-evaluations run))
        (compare-slopes run expansion t))
      nil)))

(defconstant +one-above+ (+ 1d0 8.9d-16))
(defconstant +one-below+ (- 1d0 8.9d-16))

(defun compare-slopes (run expansion moved)
  "DEFECT becomes the largest one of the slopes of the polynomials; MOVED: what rounding makes of rates does not count."
  (let ((rates (taylor-work-rates expansion)) (others (taylor-work-other-rates expansion))
        (slopes (taylor-work-slopes expansion)) (absolute (run-absolute run)) (worst 0d0))
    (declare (type (simple-array double-float (*)) rates others slopes absolute) (double-float worst))
    (with-run (run)
      (let ((inverse (flo (/ 1d0 (noted expansion unit))))
            (relative (control relative)))
        (declare (double-float inverse relative))
        (for (i n)
          (let* ((defect (flo (abs (- (* inverse (aref slopes i)) (aref rates i)))))
                 (size (flo (max (abs (aref state i)) (abs (aref next i)))))
                 (unit (flo (max (+ (aref absolute i) (* relative size)) +least-unit+)))
                 (error (flo (/ (* defect (abs h)) (* +most-defect+ unit)))))
            (declare (double-float defect size unit error))
            (when moved
              (let ((rounding (flo (abs (- (aref others i) (aref rates i))))))
                (declare (double-float rounding))
                (when (< defect (flo (* 100d0 rounding))) (setq error 0d0))))
            (cond ((not (< error 1d100)) (setq worst 1d100))
                  ((> error worst) (setq worst error)))))
        (setf (noted expansion defect) worst)
        nil))))

(defun root-instructions (kernel work)
  "The numbers of the instructions that are square roots or broken powers, with the constants in WORK."
  (loop for (operation) across (series-kernel-instructions kernel)
        for index from 0
        when (and (member operation '(:sqrt :power)) (not (whole-power-p kernel work index))) collect index))

(defun root-vanishes-p (expansion part)
  "Whether a root changes its sign within PART of the unit of time: a series goes on through where what a root is taken
of vanishes, the motion does not."
  (declare (double-float part))
  (let* ((kernel (taylor-work-kernel expansion)) (work (taylor-work-here expansion))
         (states (series-kernel-states kernel)) (order (1- (taylor-work-order expansion))))
    (declare (type (simple-array double-float (*)) work) (fixnum order states))
    (dolist (index (taylor-work-roots expansion) nil)
      (let ((value (with-fast-arithmetic
                     (polynomial-at work (the fixnum (* +room+ (+ 1 (the fixnum index) states))) order part))))
        (declare (double-float value))
        (unless (> value 0d0) (return t))))))

(defun whole-power-p (kernel work index)
  (destructuring-bind (operation base &optional exponent) (svref (series-kernel-instructions kernel) index)
    (declare (ignore base))
    (and (eq operation :power)
         (let ((number (aref (the double-array work) (+ (series-kernel-constants kernel) exponent))))
           (= number (fround number))))))

(defun end-of-polynomials (run expansion)
  "The state at the end of the step, and the slopes there; whether it is finite."
  (let ((work (taylor-work-here expansion)) (order (taylor-work-order expansion))
        (slopes (taylor-work-slopes expansion)))
    (declare (type (simple-array double-float (*)) slopes work) (fixnum order))
    (with-run (run)
      (let ((part (flo (/ h (noted expansion unit)))) (sum 0d0))
        (declare (double-float part sum))
        (for (i n)
          (with-polynomial (value slope) (work (fix (* +room+ i)) order part)
            (setf (aref next i) value (aref slopes i) slope)
            (setq sum (flo (+ sum (abs value))))))
        (< sum 1d305)))))

(defun sketch-taylor (run)
  "Go to the end of the step."
  (declare (type run run))
  (cond ((by-series-p run) (go-by-series run (run-work run)))
        ((plain-p run) (go-by-stages run (run-work run) #'sketch-dop853))
        (t (by-stages run #'sketch-dop853))))

(defun go-by-stages (run expansion function)
  "What FUNCTION of dop853.lisp gives."
  (with-control (run) (setf (gethash (control time) (taylor-work-table expansion)) t))
  (prog1 (by-stages run function)
    (setf (taylor-work-fresh expansion) nil
          (taylor-work-rates-known expansion) t)))

(defun go-by-series (run expansion)
  "Expand at the end of the step, unless that is the end of all."
  (setf (taylor-work-rates-known expansion) nil
        (taylor-work-fresh expansion) nil)
  (with-run (run)
    (let ((end (flo (+ now h))) (length (flo (abs h))))
      (declare (double-float end length))
      (setf (taylor-work-last expansion) length)
      (when (> length (taylor-work-longest expansion)) (setf (taylor-work-longest expansion) length))
      (unless (zerop (hash-table-count (taylor-work-table expansion)))
        (remhash now (taylor-work-table expansion)))
      (unless (= end (control end))
        (let* ((unit (noted expansion unit)) (part (flo (/ length unit))))
          (declare (double-float unit part))
          (unless (and (< 1d-3 part) (< part 1d3))
            (setq unit (the double-float (near-power length))))
          (setf (noted expansion next-unit) unit
                (noted expansion next-time) end))
        (expand-next run expansion))))
  nil)

(defun expand-next (run expansion)
  "Expand where the step ends."
  (when (eq t (expand-at run expansion (taylor-work-there expansion) (run-next run)))
    (setf (noted expansion longest) (noted expansion next-longest)
          (noted expansion unit) (noted expansion next-unit))
    (rotatef (taylor-work-here expansion) (taylor-work-there expansion))
    (setf (taylor-work-fresh expansion) t)))

(defun complete-taylor (run)
  "Go to the end of the step; what is kept of it."
  (cond ((by-series-p run)
         (prog1 (kept-polynomials run (run-work run))
           (go-by-series run (run-work run))))
        ((plain-p run) (list (go-by-stages run (run-work run) #'complete-dop853)))
        (t (list (by-stages run #'complete-dop853)))))

(defun by-series-p (run)
  "Whether the step that is being taken is one by series."
  (and (plain-p run) (not (taylor-work-staged (run-work run)))))

(defun kept-polynomials (run expansion)
  (let* ((work (taylor-work-here expansion)) (n (run-n run)) (end (* +room+ n)) (kept (subseq work 0 (+ end 2))))
    (declare (type (simple-array double-float (*)) kept work) (fixnum n end))
    (with-control (run)
      (setf (aref kept end) (control time)
            (aref kept (fix (+ end 1))) (noted expansion unit))
      kept)))

(defun taylor-value (kept time out n order)
  (if (consp kept)
      (dop853-value (first kept) time out n)
      (taylor-value-of kept time out n order)))

(defun taylor-value-of (kept time out n order)
  (declare (type (simple-array double-float (*)) kept out) (double-float time) (fixnum n order))
  (with-fast-arithmetic
    (let* ((end (fix (* +room+ n))) (part (flo (/ (- time (aref kept end)) (aref kept (fix (+ end 1)))))))
      (declare (fixnum end) (double-float part))
      (for (i n)
        (setf (aref out i) (polynomial-at kept (fix (* +room+ i)) order part)))
      nil)))

(defparameter *shrunk* 0.1d0 "Steps that are so much shorter than the longest may be due to a root that vanishes.")

(defun choose-taylor (run)
  (let ((expansion (run-work run)))
    (cond ((not (by-series-p run)) (choose-step run))
          ((taylor-work-fresh expansion)
           (with-control (run)
             (let ((longest (noted expansion longest)))
               (declare (double-float longest))
               (setf (control step) (flo (* (control direction)
                                            (min (min (control longest) (* 6d0 (abs (control step)))) longest))))
               (setf (taylor-work-probing expansion) nil)
               (cond ((null (taylor-work-roots expansion)) nil)
                     ((> longest (flo (* (the double-float *shrunk*) (taylor-work-longest expansion))))
                      (setf (taylor-work-probed expansion) 1d300))
                     ((< longest (flo (* 0.5d0 (taylor-work-probed expansion))))
                      (setf (taylor-work-probing expansion) t
                            (taylor-work-probed expansion) longest
                            (control step) (flo (* 3d0 (control step)))))
                     ((> longest (flo (* 4d0 (taylor-work-probed expansion))))         ; behind the root
                      (setf (taylor-work-probed expansion) (flo (* 2d0 longest)))))))))))

;;; Stability

(defun taylor-decay (run)
  "The rate of what decays fastest: the last terms of series that stability bounds are all its."
  (if (by-series-p run)
      (let* ((expansion (run-work run)) (order (taylor-work-order expansion)) (work (taylor-work-here expansion)))
        (if (taylor-work-fresh expansion) (decay-of-terms run work order (taylor-work-numbers expansion)) 0d0))
      (let ((rate (by-stages run #'dop853-decay)))
        (if (with-control (run) (<= (control relative) *fine-stages*)) (* *sooner* rate) rate))))

(defparameter *fine-stages* 1d-15 "Of stages to such a part of the states, roundings take part in the error of a step.")
(defparameter *sooner* 2.5d0 "So stability bounds steps that are so much shorter.")

(defparameter *terms-of-decay* 4 "So many times the last terms alternate in their signs where they are a decay's.")

(defun decay-of-terms (run work order numbers)
  "That rate, where all the last terms alternate in their signs: two do so in an oscillation, too."
  (declare (type (simple-array double-float (*)) work numbers) (fixnum order))
  (with-control (run)
    (let ((absolute (run-absolute run)) (relative (control relative)) (rate 0d0))
      (declare (type (simple-array double-float (*)) absolute) (double-float relative rate))
      (for (back (the fixnum (min (the fixnum *terms-of-decay*) (fix (- order 1)))))
        (let ((k (fix (- order back))) (last 0d0) (before 0d0) (both 0d0))
          (declare (fixnum k) (double-float last before both))
          (for (i (run-n run))
            (let* ((place (fix (* +room+ i)))
                   (unit (flo (max (+ (aref absolute i) (* relative (abs (aref work place)))) 1d-290)))
                   (a (flo (/ (aref work (fix (+ place k))) unit)))
                   (b (flo (/ (aref work (fix (+ place k -1))) unit))))
              (declare (fixnum place) (double-float unit a b))
              (setq last (flo (+ last (* a a))) before (flo (+ before (* b b))) both (flo (+ both (* a b))))))
          (unless (and (> before 0d0)
                       (< (flo (* both (control direction))) (flo (* -0.9d0 (sqrt last) (sqrt before)))))
            (return-from decay-of-terms 0d0))
          (when (= back 0)
            (setq rate (flo (/ (* (sqrt last) (+ 0d0 order)) (sqrt before) (aref numbers 1)))))))
      rate)))

;;; The method

(defparameter *whole-polynomials* 1000 "Of so many steps they are kept at once: to take a step again costs two.")

(defun taylor-formulas (task)
  "A function that makes the formula of a tolerance for TASK."
  (let ((part (part-for-order (problem-model (task-problem task)))))
    (lambda (tolerance) (taylor-formula (order-for (tolerance-relative tolerance) part)))))

(defun part-for-order (model)
  "Longer steps of higher orders would lead over narrow bumps of what is steep."
  (cond ((steep-arguments (model-kernel model)) *order-of-steep*)
        ((<= (sums-of-products (model-series-program model)) *few-sums*) *order-of-few*)
        (t *order-of-many*)))

(defun taylor-formula (order)
  (let ((table (make-hash-table :size 7)))
    (make-formula :order (1+ order) :begin (lambda (run) (begin-taylor run table))
                  :attempt #'attempt-taylor :complete #'complete-taylor :safe #'by-series-p :sketch #'sketch-taylor
                  :choose #'choose-taylor
                  :decay #'taylor-decay :stable (min (* 0.3d0 order) +stable+)        ; also for steps by stages
                  :even (lambda () (zerop (hash-table-count table)))
                  :value (lambda (kept time out n) (taylor-value kept time out n order))
                  :room (lambda (n) (+ 2 (* n +room+))) :whole *whole-polynomials*)))

;;; The first pass: as tolerances hardly make costs, one that is likely to be enough at once costs less than a coarse
;;; one and then another; and that of the integration is so fine that the check, whose errors are a hundred times as
;;; large, seldom agrees by chance, and that another check, if it has to be finer, serves the same integration.

(defparameter *part-of-check* 2d-4 "Of the accuracy that is asked for, the tolerance of the first check.")
(defparameter *least-check* 1d-13 "No finer than this: there, rounding begins to govern.")
(defparameter *finest-at-once* 2d-12 "The accuracy for which that would seldom do.")
(defparameter *apart-of-series* 100 "How much finer the integration is.")

(defun first-check-of-series (accuracy)
  (if (<= accuracy *finest-at-once*)
      (* *least-apart* *finest*)
      (max *least-check* (* *part-of-check* accuracy))))

(defun first-tolerance-of-series (check)
  (let ((tolerance (/ check *apart-of-series*)))
    (if (< tolerance *fine*) *finest* tolerance)))

;;; Where no method was chosen.  Measured by bench/auto.sh: the series of few products cost less than the stages of
;;; dop853.lisp, the more so the finer the accuracy; to a fine one those of more products, too, once they have straight
;;; code (series_code.lisp).  Close encounters, which make steps short, and many products make them cost more.  Where
;;; equations switch, or steps are moved, pieces are too short for them; and where nothing is verified, a single run by
;;; stages costs less.

(defparameter *coarsest* 1d-8 "To coarser accuracies little is won, and where steps are short, lost.")
(defparameter *finer* 1d-9 "To this one more products may be than else.")
(defparameter *more-sums* 16)
(defparameter *cheap-work* 200 "Nor may there be more operations.")

(defparameter *minute* 1d-280 "Terms of the series of smaller states are too small for doubles.")

(defun minute-p (state)
  (< 0d0 (reduce #'max state :key #'abs) *minute*))

(defun why-series (task)
  "Why the motion of TASK costs less by series, a sentence; nil if it does not."
  (let* ((problem (task-problem task)) (model (problem-model problem)) (accuracy (task-accuracy task)))
    (and (task-verify task)
         (<= accuracy *coarsest*)
         (not (minute-p (subseq (problem-start problem) 0 (problem-n problem))))
         (not (or (problem-projection problem) (model-surfaces model)))
         (<= (model-work model) *cheap-work*)
         (let ((sums (sums-of-products (model-series-program model))))
           (and (<= sums (if (<= accuracy *finer*) *more-sums* *few-sums*))
                (format nil "to this accuracy series of ~d product~:p cost less" sums))))))

(defun taylor-trouble (options)
  (or (digits-trouble options) (rigorous-trouble options) (simd-trouble options)))

(defun simd-trouble (options)
  "What is wrong with the option simd, a sentence, or nil."
  (let ((simd (cdr (assoc 'maxima::$simd options))))
    (cond ((not (member simd '(t nil))) (format nil "simd must be true or false, found ~a" (one-line simd)))
          ((and simd (or (assoc 'maxima::$digits options) (rigorous-p options)))
           "simd = true computes with doubles: it does not go together with digits and rigorous"))))

(defun taylor-in-lanes (task kept)
  "See the slot TOGETHER of INTEGRATOR."
  (let* ((model (problem-model (task-problem task))) (kernel (model-kernel model)))
    (motions-in-lanes task kept kernel
                      (lambda (tolerance) (order-for tolerance (part-for-order model)))
                      (mapcar (lambda (place) (floor place +room+)) (steep-arguments kernel)))))

(register-integrator "taylor" :options '("digits" "rigorous" "simd") :check #'taylor-trouble
                     :many "simd" :together #'taylor-in-lanes
                     :suits (lambda (kind given)
                              (declare (ignore kind))
                              (and (some (lambda (option) (assoc option given))
                                         '(maxima::$digits maxima::$rigorous maxima::$simd))
                                   2))
                     :outdoes #'why-series
                     :run (lambda (task)
                            (cond ((rigorous-p (task-options task)) (enclosed-motion task))
                                  ((long-digits (task-options task))
                                   (motion-in-digits task (lambda (tolerance most-steps)
                                                            (error-of-tolerance task (taylor-formulas task) tolerance
                                                                                most-steps))))
                                  (t (let ((check (first-check-of-series (task-accuracy task))))
                                       (motion-by-formula task (taylor-formulas task)
                                                          (first-tolerance-of-series check) check))))))
