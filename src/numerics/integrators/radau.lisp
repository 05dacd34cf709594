;;; anmech: Radau's collocation methods of orders 5, 9 and 13, for stiff equations.
;;;
;;; It registers itself as method = radau.  The stages of a step are found by Newton's method with one matrix of
;;; derivatives (differentiation.lisp), which serves as long as it converges fast.  In the eigenvectors of the rule's
;;; matrix (collocation.lisp) the stages part into one real system of equations and complex ones, each of the size of
;;; the state.  The estimate of the error compares with a formula that has the same stages and the rates at the
;;; beginning of the step; it is passed through the real matrix, so that what decays fast does not count.
;;;
;;; The order goes with the tolerance: it is the same in all steps of an integration, so that steps can be taken again.
;;; What is kept of a step is an array: the time, the length of the step, the state where it begins, and the divided
;;; differences of the collocation polynomial.
;;;
;;; Where a motion slides along a surface the field is not that of the program, and where the program has no derivative
;;; the motion may go on: there the matrix is one of differences.
;;;
;;; Literature: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed. 1996, IV.8; E. Hairer,
;;; G. Wanner, Stiff differential equations solved by Radau methods, J. Comput. Appl. Math. 111 (1999) 93-111;
;;; K. Gustafsson, Control-theoretic techniques for stepsize selection in implicit Runge-Kutta methods, ACM Trans.
;;; Math. Software 20 (1994) 496 (choice of the steps).

(in-package :anmech)
(needs "arithmetic/factors" "arithmetic/floats" "numerics/accuracy" "numerics/collocation" "numerics/differentiation"
       "numerics/integration" "numerics/methods" "numerics/steps")

;;; What a run keeps

(defstruct radau
  "Of S stages; matrices by rows, stages one after the other."
  (s 0 :type fixnum)
  rule eigen
  derivatives                              ; function (in matrix)
  (matrix nil :type double-array)          ; what it gave last
  (rates nil :type double-array)           ; at the beginning of the step
  (last-rates nil :type double-array)      ; and at its end
  (units nil :type double-array)           ; of each state, what its error is measured in
  (noise nil :type double-array)           ; of each state, what rounding makes of stages and estimates
  (z nil :type double-array)               ; how far the stages are from the beginning of the step
  (w nil :type double-array)               ; what these miss, in the eigenvectors; then their corrections
  (misses nil :type double-array)          ; how far the integrals of the rates in the stages are from these
  (seen nil :type double-array)            ; the rates in one of them
  (x nil :type double-array)
  (y nil :type double-array)               ; right sides, then corrections
  (differences nil :type double-array)     ; of the last step
  (new-differences nil :type double-array) ; of this one
  (bend 0d0 :type double-float)            ; how large the product of the distances to all nodes becomes in a step of 1
  (time-rates nil :type double-array)      ; of the rates by the time, where rounding counts
  (real nil :type double-array)
  (pivots nil :type (simple-array fixnum (*)))
  pairs                                    ; lists of the complex factors and their pivots
  (numbers nil :type double-array)         ; see WITH-RADAU
  (stale t)                                ; whether the matrix is to be computed again
  (fresh nil)                              ; whether it belongs to the beginning of this step
  (iterations 0 :type fixnum)
  (known nil))                             ; whether there is a last step

(defparameter *newton-part* 1d-2 "The part of the tolerance that Newton's method may leave.")

(defconstant +little+ 0.02d0 "An error so much smaller than wanted makes steps longer by no more than a half or so.")

(defmacro with-radau ((run) &body body)
  "BODY as in WITH-RUN, with the parts of its work; (number QUANTITY) is one of those that change from step to step."
  `(with-run (,run)
     (let* ((work (run-work ,run)) (s (radau-s work)) (numbers (radau-numbers work))
            (z (radau-z work)) (w (radau-w work)) (misses (radau-misses work)) (seen (radau-seen work))
            (units (radau-units work)) (noise (radau-noise work)) (rates (radau-rates work))
            (x (radau-x work)) (y (radau-y work)))
       (declare (type (simple-array double-float (*)) numbers z w misses seen units noise rates x y) (fixnum s)
                (ignorable work s numbers z w misses seen units noise rates x y))
       (macrolet ((number (quantity)
                    `(aref numbers ,(position quantity '(factored length theta contraction size
                                                         accepted-step accepted-error))))
                  (newton-unit (j)
                    "What corrections of the state J are measured in: their noise may be left, too."
                    `(flo (+ (aref units ,j) (/ (aref noise ,j) (the double-float *newton-part*)))))
                  (beyond-noise (value unit j factor)
                    "VALUE, of the state J, in UNITs, as far as it is larger than FACTOR times its noise."
                    `(flo (max (/ (- (abs ,value) (* ,factor (aref noise ,j))) ,unit)
                               (min (/ (abs ,value) ,unit) +little+)))))
         ,@body))))

(defvar *radau-rules* '() "Pairs of a number of stages, and the rule with its eigenvalues.")

(defun radau-nodes (s)
  (roots-in-unit-interval (mapcar #'- (legendre-polynomial s) (append (legendre-polynomial (1- s)) '(0)))))

(defun rule-and-eigensystem (s)
  (cdr (or (assoc s *radau-rules*)
           (let ((rule (new-rule (radau-nodes s))))
             (push (list* s rule (rule-eigensystem rule)) *radau-rules*)
             (first *radau-rules*)))))

(defun new-radau (run s)
  (let ((n (run-n run)) (problem (run-problem run)))
    (destructuring-bind (rule . eigen) (rule-and-eigensystem s)
      (flet ((fixnums () (make-array n :element-type 'fixnum :initial-element 0)))
        (make-radau :s s :rule rule :eigen eigen
                    :derivatives (if (problem-surfaces problem)
                                     (differences-of-run run)
                                     (derivatives-or-differences run (field-derivatives (problem-model problem))))
                    :matrix (zeros (* n n)) :rates (zeros n) :last-rates (zeros n) :units (zeros n)
                    :noise (zeros n) :z (zeros (* s n)) :w (zeros (* s n)) :misses (zeros (* s n)) :seen (zeros n)
                    :x (zeros n) :y (zeros n)
                    :differences (zeros (* s n)) :new-differences (zeros (* s n)) :bend (largest-product (rule-c rule))
                    :time-rates (zeros n) :real (zeros (* n n)) :pivots (fixnums)
                    :pairs (loop repeat (floor s 2) collect (list (zeros (* n n)) (zeros (* n n)) (fixnums)))
                    :numbers (zeros 7))))))

(defun largest-product (nodes)
  (loop for k from 1 to 200
        for place = (/ k 200d0)
        maximize (* place (reduce #'* (map 'list (lambda (c) (abs (- place c))) nodes)))))

;;; The matrix of derivatives

(defun differences-of-run (run)
  "A function (in matrix): derivatives of the field of RUN by the states, as differences."
  (let* ((n (run-n run)) (before (zeros n)) (after (zeros n)))
    (declare (type (simple-array double-float (*)) before after) (fixnum n))
    (lambda (in matrix)
      (declare (type (simple-array double-float (*)) in matrix))
      (let ((field (run-field run)))
        (funcall field in before)
        (incf (run-evaluations run) (1+ n))
        (dotimes (j n)
          (let* ((kept (aref in j)) (unit (max (abs kept) (aref (the double-array (run-largest run)) j)))
                 (moved (+ kept (* 1.5d-8 (if (zerop unit) 1d-6 unit)))) (step (- moved kept)))
            (setf (aref in j) moved)
            (funcall field in after)
            (setf (aref in j) kept)
            (dotimes (i n)
              (setf (aref matrix (+ j (* i n))) (/ (- (aref after i) (aref before i)) step)))))))))

(defun derivatives-or-differences (run derivatives)
  (let ((differences (differences-of-run run)))
    (lambda (in matrix)
      (handler-case (funcall derivatives in matrix)
        ((or domain-violation arithmetic-error) () (funcall differences in matrix))))))

(defparameter *noisy* 1d-5 "A tolerance from which on rounding may count.")

(defun renew-matrix (run)
  "Derivatives at the beginning of the step."
  (let ((work (run-work run)))
    (place-state run)
    (funcall (the function (radau-derivatives work)) (run-in run) (radau-matrix work))
    (with-radau (run)
      (setf (number factored) 0d0)
      (when (and (problem-timed (run-problem run)) (< (control relative) (the double-float *noisy*)))
        (find-time-rates run)))
    (setf (radau-stale work) nil (radau-fresh work) t)))

(defun find-time-rates (run)
  "What the rates change in proportion to a change of the time."
  (with-radau (run)
    (let ((time-rates (radau-time-rates work)) (part 1d-8))
      (declare (type (simple-array double-float (*)) time-rates) (double-float part))
      (incf (run-evaluations run) 2)
      (funcall field in time-rates)
      (setf (aref in n) (flo (* now (+ 1d0 part))))
      (funcall field in seen)
      (setf (aref in n) now)
      (for (j n) (setf (aref time-rates j) (flo (/ (abs (- (aref seen j) (aref time-rates j))) part))))
      nil)))

(defun factor-matrices (run)
  "The factors of g/h - J for the eigenvalues g, unless they are known; nil if one of the matrices is singular."
  (with-radau (run)
    (or (<= (flo (abs (- (number factored) h))) (flo (* 1d-9 (abs h))))
        (let ((eigen (radau-eigen work)))
          (setf (number factored) h)
          (shift-matrix n (radau-matrix work) (/ (eigensystem-value eigen) h) 0d0 (radau-real work) (radau-real work))
          (and (factor-real n (radau-real work) (radau-pivots work))
               (loop for (re im pivots) in (radau-pairs work)
                     for real across (eigensystem-real eigen)
                     for imaginary across (eigensystem-imaginary eigen)
                     always (progn (shift-matrix n (radau-matrix work) (/ real h) (/ imaginary h) re im)
                                   (factor-complex n re im pivots))))))))

(declaim (ftype (function (fixnum t t t t t) t) shift-matrix))

(defun shift-matrix (n matrix real imaginary re im)
  "RE and, unless it is the same array, IM: (REAL + i IMAGINARY) - MATRIX."
  (declare (fixnum n) (double-float real imaginary) (type (simple-array double-float (*)) matrix re im))
  (with-fast-arithmetic
    (unless (eq re im) (fill im 0d0))
    (for (k (fix (* n n))) (setf (aref re k) (flo (- (aref matrix k)))))
    (for (i n)
      (let ((place (fix (+ i (* n i)))))
        (declare (fixnum place))
        (setf (aref re place) (flo (+ (aref re place) real)))
        (unless (eq re im) (setf (aref im place) imaginary))))
    nil))

;;; The stages

(declaim (ftype (function (fixnum fixnum t t t) t) change-basis))

(defun change-basis (s n matrix from to)
  "TO: MATRIX of S rows times the S vectors FROM."
  (declare (fixnum s n) (type (simple-array double-float (*)) matrix from to))
  (with-fast-arithmetic
    (for (i s)
      (let ((target (fix (* i n))))
        (declare (fixnum target))
        (for (j n) (setf (aref to (fix (+ target j))) 0d0))
        (for (k s)
          (let ((factor (aref matrix (fix (+ k (* i s))))) (source (fix (* k n))))
            (declare (double-float factor) (fixnum source))
            (for (j n)
              (setf (aref to (fix (+ target j)))
                    (flo (+ (aref to (fix (+ target j))) (* factor (aref from (fix (+ source j))))))))))))
    nil))

(declaim (ftype (function (fixnum fixnum t t t t fixnum) t) add-rise))

(defun add-rise (s n differences c part out offset)
  "Add what the polynomial of DIFFERENCES rises by in a PART of the step to OUT, from OFFSET on."
  (declare (fixnum s n offset) (double-float part) (type (simple-array double-float (*)) differences c out))
  (with-fast-arithmetic
    (for (j n)
      (let ((value 0d0))
        (declare (double-float value))
        (do ((k (fix (- s 1)) (fix (- k 1))))
            ((< k 0))
          (declare (fixnum k))
          (let ((factor (if (= k 0) part (flo (- part (aref c (fix (- k 1))))))))
            (declare (double-float factor))
            (setq value (flo (* factor (+ value (aref differences (fix (+ j (* k n))))))))))
        (let ((place (fix (+ offset j))))
          (declare (fixnum place))
          (setf (aref out place) (flo (+ (aref out place) value))))))
    nil))

(defun find-differences (run)
  "Of the polynomial through the beginning of the step and its stages."
  (with-radau (run)
    (let ((differences (radau-new-differences work)) (c (rule-c (radau-rule work))))
      (declare (type (simple-array double-float (*)) differences c))
      (replace differences z)
      (for (order s)
        (do ((k (fix (- s 1)) (fix (- k 1))))
            ((< k order))
          (declare (fixnum k))
          (let* ((back (fix (- k order 1)))                  ; the node that the difference begins at; -1: at 0
                 (way (flo (- (aref c k) (if (< back 0) 0d0 (aref c back))))) (place (fix (* k n))))
            (declare (fixnum back place) (double-float way))
            (for (j n)
              (let ((here (fix (+ place j))))
                (declare (fixnum here))
                (setf (aref differences here)
                      (flo (/ (- (aref differences here) (if (= k 0) 0d0 (aref differences (fix (- here n)))))
                              way))))))))
      nil)))

(defparameter *far-ahead* 2d0 "In steps that are so many times longer than the last one its polynomial tells nothing.")

(defun guess-stages (run)
  "By the polynomial of the last step, beyond its end; or at the beginning of this one."
  (with-radau (run)
    (fill z 0d0)
    (when (and (radau-known work) (< (flo (/ h (number length))) (the double-float *far-ahead*)))
      (let ((c (rule-c (radau-rule work))) (differences (radau-differences work)))
        (declare (type (simple-array double-float (*)) c))
        (fill x 0d0)
        (add-rise s n differences c 1d0 x 0)
        (for (i s)
          (let ((place (fix (* i n))))
            (declare (fixnum place))
            (for (j n) (setf (aref z (fix (+ place j))) (flo (- (aref x j)))))
            (add-rise s n differences c (flo (+ 1d0 (/ (* (aref c i) h) (number length)))) z place)))))
    nil))

;; The stages themselves are corrected, by what they miss of the integrals of their rates: the eigenvectors only lead
;; there.  Kept in these, stages would have what rounding makes of them in all steps alike: motions of all tolerances
;; would gain or lose energy alike, and no comparison of them tells it (Hairer, McLachlan, Razakarivony, Achieving
;; Brouwer's law with implicit Runge-Kutta methods, BIT 48 (2008) 231).
(defun find-misses (run)
  (with-radau (run)
    (let ((c (rule-c (radau-rule work))) (a (rule-a (radau-rule work))))
      (declare (type (simple-array double-float (*)) c a))
      (fill misses 0d0)
      (incf (run-evaluations run) s)
      (for (i s)
        (let ((place (fix (* i n))))
          (declare (fixnum place))
          (for (j n) (setf (aref in j) (flo (+ (aref state j) (aref z (fix (+ place j)))))))
          (setf (aref in n) (flo (+ now (* (aref c i) h))))
          (funcall field in seen)
          (for (k s)
            (let ((factor (aref a (fix (+ i (* k s))))) (target (fix (* k n))))
              (declare (double-float factor) (fixnum target))
              (for (j n)
                (setf (aref misses (fix (+ target j)))
                      (flo (+ (aref misses (fix (+ target j))) (* factor (aref seen j))))))))))
      (for (k (fix (* s n))) (setf (aref misses k) (flo (- (* h (aref misses k)) (aref z k)))))
      nil)))

(defun correct-stages (run)
  "One step of Newton's method; the size of the corrections goes to (number size): in the eigenvectors, where it is
larger, unless those of the stages are noise."
  (with-radau (run)
    (let* ((eigen (radau-eigen work)) (sum 0d0) (value (flo (/ (eigensystem-value eigen) h))) (place n))
      (declare (double-float sum value) (fixnum place))
      (change-basis s n (eigensystem-from-stages eigen) misses w)
      (for (j n) (setf (aref x j) (flo (* value (aref w j)))))
      (solve-real n (radau-real work) (radau-pivots work) x)
      (for (j n)
        (let ((part (flo (/ (aref x j) (newton-unit j)))))
          (declare (double-float part))
          (setq sum (flo (+ sum (* part part))))
          (setf (aref w j) (aref x j))))
      (loop for (re im pivots) in (radau-pairs work)
            for real across (the double-array (eigensystem-real eigen))
            for imaginary across (the double-array (eigensystem-imaginary eigen))
            do (setq sum (flo (+ sum (the double-float
                                          (correct-pair run place (/ real h) (/ imaginary h) re im pivots))))
                     place (fix (+ place n n))))
      (setf (number size) (flo (sqrt (/ sum (float (fix (* s n)) 1d0)))))
      (change-basis s n (eigensystem-to-stages eigen) w misses)
      (for (k (fix (* s n))) (setf (aref z k) (flo (+ (aref z k) (aref misses k)))))
      (setf (number size) (flo (min (number size) (the double-float (size-by-noise run)))))
      nil)))

(defun size-by-noise (run)
  "The size of the corrections of Z, which are in MISSES, in units of what noise makes of them: in the eigenvectors
noise is larger, too, by hundreds of times where the stages are many, and no correction would be small enough."
  (with-radau (run)
    (let ((sum 0d0))
      (declare (double-float sum))
      (for (j n)
        (let ((unit (flo (/ (aref noise j) (the double-float *newton-part*)))))
          (declare (double-float unit))
          (for (i s)
            (let ((correction (flo (abs (aref misses (fix (+ j (* i n))))))))
              (declare (double-float correction))
              (unless (<= correction (flo (* 1d3 unit))) (return-from size-by-noise 1d300))
              (when (> unit 0d0)
                (let ((part (flo (/ correction unit))))
                  (declare (double-float part))
                  (setq sum (flo (+ sum (* part part))))))))))
      (flo (sqrt (/ sum (float (fix (* s n)) 1d0)))))))

(defun correct-pair (run place real imaginary re im pivots)
  "The same of the two vectors of W from PLACE on, of the eigenvalue REAL + i IMAGINARY; the sum of the squares."
  (declare (fixnum place) (double-float real imaginary))
  (with-radau (run)
    (let ((sum 0d0) (other (fix (+ place n))))
      (declare (double-float sum) (fixnum other))
      (for (j n)                            ; as the complex vector w - i w'
        (let ((p (aref w (fix (+ place j)))) (q (flo (- (aref w (fix (+ other j)))))))
          (declare (double-float p q))
          (setf (aref x j) (flo (- (* real p) (* imaginary q)))
                (aref y j) (flo (+ (* real q) (* imaginary p))))))
      (solve-complex n re im pivots x y)
      (for (j n)
        (let ((p (flo (/ (aref x j) (newton-unit j))))
              (q (flo (/ (aref y j) (newton-unit j)))))
          (declare (double-float p q))
          (setq sum (flo (+ sum (* p p) (* q q))))
          (setf (aref w (fix (+ place j))) (aref x j)
                (aref w (fix (+ other j))) (flo (- (aref y j))))))
      sum)))

(defparameter *trusted-contraction* 1d-3
  "No faster convergence is trusted before it is seen in a step: that of the last one, where less was to be corrected
and the matrix was newer, may have been by chance.")

(defun most-iterations (s) (+ 7 (floor (* 5 (- s 3)) 2)))

(defun solve-stages (run)
  "Whether Newton's method has found them."
  (guess-stages run)
  (with-radau (run)
    (let* ((most (most-iterations s)) (enough (the double-float *newton-part*)) (previous 0d0) (previous-rate 0d0))
      (declare (double-float enough previous previous-rate) (fixnum most))
      (setf (number contraction)
            (flo (max (raised (flo (max (number contraction) 1d-16)) 0.8d0) (the double-float *trusted-contraction*)))
            (number theta) 0d0)
      (loop for count of-type fixnum from 1 to most
            do (find-misses run)
               (correct-stages run)
               (setf (radau-iterations work) count)
               (let ((size (number size)))
                 (declare (double-float size))
                 (unless (< size 1d100) (return nil))
                 (when (> count 1)
                   (let ((rate (flo (/ size (max previous 1d-300)))))
                     (declare (double-float rate))
                     (setf (number theta) (if (= count 2) rate (flo (sqrt (* rate previous-rate))))
                           previous-rate rate)
                     (cond ((<= size (flo (* 1d-3 enough))))
                           ((not (< (number theta) 0.99d0)) (return nil))
                           (t (setf (number contraction) (flo (/ (number theta) (- 1d0 (number theta)))))
                              (when (> (flo (* (number contraction) size
                                               (raised (flo (max (number theta) 1d-16))
                                                       (float (fix (- most count)) 1d0))))
                                       enough)
                                (return nil))))))
                 (setq previous size)
                 (when (<= (flo (* (number contraction) size)) enough) (return t)))))))

(defun find-noise (run)
  "What rounding of states and time makes of stages and estimates: rates have terms that cancel, and what is left of
their roundings passes through the matrix like all else."
  (with-radau (run)
    (fill noise 0d0)
    (when (< (control relative) (the double-float *noisy*))
      (let ((matrix (radau-matrix work)) (time-rates (radau-time-rates work)))
        (declare (type (simple-array double-float (*)) matrix time-rates))
        (for (i n)
          (let ((terms (aref time-rates i)) (row (fix (* i n))))
            (declare (double-float terms) (fixnum row))
            (for (j n) (setq terms (flo (+ terms (abs (* (aref matrix (fix (+ row j))) (aref state j)))))))
            (setf (aref x i) (if (evenp i) terms (flo (- terms))))))
        (solve-real n (radau-real work) (radau-pivots work) x)
        (for (j n) (setf (aref noise j) (flo (* 4d-16 (+ (abs (aref state j)) (abs (aref x j)))))))))
    t))

;;; A step

(defun begin-radau (run s)
  (unless (run-work run) (setf (run-work run) (new-radau run s)))
  (let ((work (run-work run)))
    (setf (radau-stale work) t (radau-known work) nil)
    (with-radau (run) (setf (number contraction) 1d0 (number accepted-step) 0d0))
    (incf (run-evaluations run))
    (funcall (the function (run-field run)) (run-in run) (radau-rates work))
    (radau-rates work)))

(defconstant +of-differences+ 30d0 "How much larger roundings are in the last differences than in the stages.")
(defconstant +of-estimates+ 2d0 "The same of the estimates of errors.")
(defconstant +nothing+ 1d250 "The error of a step that nothing came of.")

(defun attempt-radau (run)
  (let ((work (run-work run)))
    (measure-states run)
    (with-control (run)
      (setf (control error) +nothing+)
      (when (or (stages-found-p run)
                (and (not (radau-fresh work))
                     (progn (setf (radau-stale work) t) (stages-found-p run))))
        (estimate-error run)))
    nil))

(defun stages-found-p (run)
  (when (radau-stale (run-work run)) (renew-matrix run))
  (and (factor-matrices run) (find-noise run) (solve-stages run)))

(defun factor-of-units (relative)
  "A tolerance finer than rounding, which equations that are solved cannot have, is taken for 1e-15."
  (declare (double-float relative))
  (if (< 0d0 relative 1d-15) (/ 1d-15 relative) 1d0))

(defun measure-states (run)
  (with-radau (run)
    (let* ((absolute (run-absolute run)) (relative (control relative)) (factor (factor-of-units relative)))
      (declare (double-float relative factor) (type (simple-array double-float (*)) absolute))
      (for (j n)
        (setf (aref units j)
              (flo (max (* factor (+ (aref absolute j) (* relative (abs (aref state j))))) +least-unit+)))))))

(defun estimate-error (run)
  "The end of the step to NEXT, and the estimate of its error; within the step, too."
  (find-differences run)
  (with-radau (run)
    (let ((end (fix (* n (fix (- s 1))))))
      (declare (fixnum end))
      (for (j n) (setf (aref next j) (flo (+ (aref state j) (aref z (fix (+ end j)))))))
      (find-excess run)
      (let ((error (error-of-excess run rates)))
        (declare (double-float error))
        ;; of what decays fast within the step: the rates where the first estimate leads
        (when (and (>= error 1d0) (< error 1d200)
                   (or (run-after-rejection run) (not (radau-known work))))
          (for (j n) (setf (aref in j) (flo (+ (aref state j) (aref x j)))))
          (setf (aref in n) now)
          (incf (run-evaluations run))
          (funcall field in seen)
          (setq error (error-of-excess run seen)))
        (when (radau-known work) (setq error (flo (max error (the double-float (error-between run))))))
        (setf (control error) (if (< error 1d200) error +nothing+))
        nil))))

;; Of states that follow others at once, as the motion does after a fast decay, the end of a step is right whatever lies
;; between: then the error there is that of the polynomial.
(defun error-between (run)
  "The size of the next term of the polynomial's series, from how much its last one has changed since the last step."
  (with-radau (run)
    (let* ((before (radau-differences work)) (after (radau-new-differences work)) (sum 0d0)
           (ratio (flo (/ h (number length)))) (power (the double-float (expt ratio s)))
           (place (fix (* n (fix (- s 1)))))
           (part (flo (/ (* 2d0 (radau-bend work) ratio) (* (+ 1d0 ratio) (float (fix (+ s 1)) 1d0))))))
      (declare (type (simple-array double-float (*)) before after) (double-float sum ratio power part) (fixnum place))
      (for (j n)
        (let* ((term (flo (* part (- (aref after (fix (+ place j))) (* power (aref before (fix (+ place j))))))))
               (measured (beyond-noise term (aref units j) j +of-differences+)))
          (declare (double-float term measured))
          (setq sum (flo (+ sum (* measured measured))))))
      (flo (sqrt (/ sum (+ 0d0 n)))))))

(defun find-excess (run)
  "Y: the rates that the polynomial of the stages has at the beginning of the step."
  (with-radau (run)
    (let ((d (rule-d (radau-rule work))) (behind (rule-behind (radau-rule work))))
      (declare (type (simple-array double-float (*)) d behind))
      (fill y 0d0)
      (for (k s)
        (let ((weight 0d0) (place (fix (* k n))))
          (declare (double-float weight) (fixnum place))
          (for (i s) (setq weight (flo (+ weight (* (aref behind i) (aref d (fix (+ k (* i s)))))))))
          (setq weight (flo (/ weight h)))
          (for (j n)
            (setf (aref y j) (flo (+ (aref y j) (* weight (aref z (fix (+ place j))))))))))
      nil)))

(defun error-of-excess (run rates)
  "X: the difference from the other formula, RATES those at the beginning of the step; its size."
  (declare (type (simple-array double-float (*)) rates))
  (with-radau (run)
    (let* ((sum 0d0) (absolute (run-absolute run)) (relative (control relative)) (factor (factor-of-units relative)))
      (declare (double-float sum relative factor) (type (simple-array double-float (*)) absolute))
      (for (j n) (setf (aref x j) (flo (- (aref rates j) (aref y j)))))
      (solve-real n (radau-real work) (radau-pivots work) x)
      (for (j n)
        (let* ((size (flo (max (abs (aref state j)) (abs (aref next j)))))
               (unit (flo (max (* factor (+ (aref absolute j) (* relative size))) +least-unit+)))
               (part (beyond-noise (aref x j) unit j +of-estimates+)))
          (declare (double-float size unit part))
          (setq sum (flo (+ sum (* part part))))))
      (flo (sqrt (/ sum (+ 0d0 n)))))))

(defun sketch-radau (run)
  "Go to the end of the step."
  (let ((work (run-work run)))
    (with-radau (run)
      (for (j n) (setf (aref in j) (aref next j)))
      (setf (aref in n) (flo (+ now h)))
      (incf (run-evaluations run))
      (funcall field in (radau-last-rates work))
      (rotatef (radau-rates work) (radau-last-rates work))
      (rotatef (radau-differences work) (radau-new-differences work))
      (setf (number length) h
            (radau-known work) t
            (radau-fresh work) nil)
      nil)))

(defun complete-radau (run)
  (sketch-radau run)
  (with-radau (run)
    (let ((kept (zeros (fix (+ 2 n (* s n))))))
      (setf (aref kept 0) now
            (aref kept 1) h)
      (replace kept state :start1 2)
      (replace kept (the double-array (radau-differences work)) :start1 (+ 2 n))
      kept)))

(defparameter *slow-convergence* 1d-3 "From this rate on the matrix of derivatives is renewed.")

(defun choose-radau (run)
  "The next step: by the error, and how it has changed from the last step to this one; not changed where that gains
little, for the factors serve on."
  (with-radau (run)
    (let* ((most (most-iterations s)) (error (flo (max (control error) 1d-10))) (exponent (/ 1d0 (float (+ 1 s) 1d0)))
           (safety (flo (/ (* 0.9d0 (float (+ 1 (* 2 most)) 1d0))
                            (float (+ (radau-iterations work) (* 2 most)) 1d0))))
           (growth (flo (/ safety (raised error exponent))))
           (size (flo (abs h))))
      (declare (double-float error exponent safety growth size) (fixnum most))
      (when (> (number accepted-step) 0d0)
        (setq growth (flo (min growth
                               (/ (* 0.9d0 (/ size (number accepted-step))
                                     (raised (flo (/ (number accepted-error) error)) exponent))
                                  (raised error exponent))))))
      (setq growth (flo (min (max growth 0.125d0) (if (run-after-rejection run) 1d0 8d0))))
      (setf (number accepted-step) size
            (number accepted-error) (flo (max error 1d-2))
            (radau-stale work) (> (number theta) (the double-float *slow-convergence*)))
      (unless (and (<= 1d0 growth 1.2d0) (not (radau-stale work)))
        (setq size (flo (* size growth))))
      (setf (control step) (flo (* (control direction) (min size (control longest))))
            (run-after-rejection run) nil)
      nil)))

;;; Dense output

(defun radau-value (rule)
  (let ((c (rule-c rule)))
    (lambda (kept time out n)
      (declare (type (simple-array double-float (*)) kept out) (double-float time) (fixnum n))
      (let* ((s (length (the double-array c))) (differences (subseq kept (+ 2 n))))
        (replace out kept :end1 n :start2 2)
        (add-rise s n differences c (/ (- time (aref kept 0)) (aref kept 1)) out 0)
        nil))))

;;; The method

(defun radau-formula (s)
  (make-formula :order (1+ s) :implicit t :begin (lambda (run) (begin-radau run s)) :attempt #'attempt-radau
                :complete #'complete-radau :sketch #'sketch-radau :choose #'choose-radau
                :value (radau-value (first (rule-and-eigensystem s))) :room (lambda (n) (+ 2 (* (1+ s) n)))))

(defun stages-for (tolerance)
  (cond ((> tolerance 1d-5) 3) ((> tolerance 1d-9) 5) (t 7)))

(register-integrator "radau"
                     :stiff t
                     :run (lambda (task)
                            (motion-by-formula task (lambda (tolerance)
                                                      (radau-formula (stages-for (tolerance-relative tolerance)))))))
