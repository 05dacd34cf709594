;;; anmech: Gauss' collocation methods of one to eight stages, orders 2 to 16, with steps of equal length.
;;;
;;; It registers itself as method = gauss.  The methods are symmetric, so they are reversible where the equations are;
;;; and they keep constant two-forms, so they are symplectic for Hamilton's equations in canonical variables.
;;;
;;; With L_i = h b_i f(Y_i) the stages are Y_i = y + sum_j m_ij L_j, and y + sum L_i is the end of the step.  Two-forms
;;; are kept where m_ij + m_ji = 1: the m are rounded to numbers for which this holds exactly, so that no rounded
;;; coefficient leaves a drift.  The stages are iterated from the polynomial of the last step until they change no more,
;;; or only as rounding has it.
;;;
;;; Literature: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed. 2006, II.1, IV.2, VI.4 and
;;; VIII.6; E. Hairer, R. I. McLachlan, A. Razakarivony, BIT 48 (2008) 231-243; M. Antonana, J. Makazaga, A. Murua,
;;; Reducing and monitoring round-off error propagation for symplectic implicit Runge-Kutta schemes, Numer. Algorithms
;;; 76 (2017) 861-880.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats" "numerics/collocation" "numerics/dag" "numerics/equal_steps"
       "numerics/integration" "numerics/marching" "numerics/methods" "numerics/motion")

(defstruct gauss
  (s 0 :type fixnum)
  (n 0 :type fixnum)
  field
  (b nil :type double-array)
  (c nil :type double-array)
  (m nil :type double-array)            ; see above
  (ahead nil :type double-array)        ; from h f in the stages to those of the next step
  (l nil :type double-array)
  (guess nil :type double-array)
  (rates nil :type double-array)
  (known nil))                          ; whether L holds those of the last step, of the same length

(defvar *gauss-rules* '() "Lists of a number of stages, the rule, M and AHEAD.")

(defun gauss-nodes (s) (roots-in-unit-interval (legendre-polynomial s)))

(defun gauss-rule (s)
  (rest (or (assoc s *gauss-rules*)
            (let* ((nodes (gauss-nodes s)) (rule (new-rule nodes)))
              (push (list s rule (symplectic-matrix s rule) (matrix-ahead nodes)) *gauss-rules*)
              (first *gauss-rules*)))))

(defun symplectic-matrix (s rule)
  "The m_ij = a_ij/b_j, rounded so that one minus it is a double, too."
  (let ((m (zeros (* s s))) (a (rule-a rule)) (b (rule-b rule)))
    (dotimes (i s m)
      (setf (aref m (+ i (* i s))) 0.5d0)
      (dotimes (j i)
        (let ((rounded (/ (round (* (rational (/ (aref a (+ j (* i s))) (aref b j))) (expt 2 50))) (expt 2 50))))
          (setf (aref m (+ j (* i s))) (to-double rounded)
                (aref m (+ i (* j s))) (to-double (- 1 rounded))))))))

(defun matrix-ahead (nodes)
  (let ((basis (mapcar (lambda (node) (basis-polynomial nodes node)) nodes)))
    (doubles-of (loop for node in nodes
                      append (mapcar (lambda (polynomial) (exact-value-at polynomial (1+ node))) basis)))))

(defun new-gauss (problem s)
  (destructuring-bind (rule m ahead) (gauss-rule s)
    (let ((size (* s (problem-n problem))))
      (make-gauss :s s :n (problem-n problem) :field (problem-field problem) :b (rule-b rule) :c (rule-c rule) :m m
                  :ahead ahead :l (zeros size) :guess (zeros size) :rates (zeros (problem-n problem))))))

(defmacro with-gauss ((march) &body body)
  `(with-fast-arithmetic
     (let* ((work (march-work ,march)) (s (gauss-s work)) (n (gauss-n work)) (in (march-in ,march))
            (state (march-state ,march)) (carry (march-carry ,march)) (field (gauss-field work)) (b (gauss-b work))
            (c (gauss-c work)) (m (gauss-m work)) (l (gauss-l work)) (guess (gauss-guess work))
            (rates (gauss-rates work)))
       (declare (fixnum s n) (type function field)
                (type (simple-array double-float (*)) in state carry b c m l guess rates)
                (ignorable work s n in state carry field b c m l guess rates))
       ,@body)))

(defparameter *most-sweeps* 100 "How often the stages of a step are iterated.")
(defparameter *near-rounding* 1d-12 "Changes of this size that shrink no more are those of rounding.")

(defun gauss-steps (march count time step)
  "COUNT steps from TIME on; nil, or :unsolved."
  (loop for k from 0 below count
        do (guess-increments march (+ time (* k step)) step)
           (unless (sweep-until-still march (+ time (* k step)) step) (return :unsolved))
           (take-increments march)))

(defun guess-increments (march time step)
  (declare (double-float time step))
  (with-gauss (march)
    (cond ((gauss-known work)
           (replace guess l)
           (let ((ahead (gauss-ahead work)))
             (declare (type (simple-array double-float (*)) ahead))
             (for (i s)
               (let ((target (fix (* i n))) (own (aref b i)))
                 (declare (fixnum target) (double-float own))
                 (for (j n) (setf (aref l (fix (+ target j))) 0d0))
                 (for (k s)
                   (let ((factor (flo (/ (* own (aref ahead (fix (+ k (* i s))))) (aref b k)))) (source (fix (* k n))))
                     (declare (double-float factor) (fixnum source))
                     (for (j n)
                       (setf (aref l (fix (+ target j)))
                             (flo (+ (aref l (fix (+ target j))) (* factor (aref guess (fix (+ source j))))))))))))))
          (t (for (j n) (setf (aref in j) (aref state j)))
             (setf (aref in n) time)
             (funcall field in rates)
             (incf (march-cost march))
             (for (i s)
               (let ((weight (flo (* step (aref b i)))) (target (fix (* i n))))
                 (declare (double-float weight) (fixnum target))
                 (for (j n) (setf (aref l (fix (+ target j))) (flo (* weight (aref rates j)))))))
             (setf (gauss-known work) t)))
    nil))

(defun sweep-until-still (march time step)
  (let ((before 1d300))
    (declare (double-float before))
    (loop for count of-type fixnum from 1 to *most-sweeps*
          do (let ((change (sweep march time step)))
               (declare (double-float change))
               (cond ((= change 0d0) (return t))
                     ((not (< change 1d100)) (return nil))
                     ((and (>= change before) (< before (the double-float *near-rounding*))) (return t)))
               (setq before change)))))

(defun sweep (march time step)
  "The stages once, from the increments as they are; the largest change of one, relative to the state it belongs to."
  (declare (double-float time step))
  (with-gauss (march)
    (let ((worst 0d0))
      (declare (double-float worst))
      (incf (march-cost march) s)
      (for (i s)
        (let ((row (fix (* i s))) (target (fix (* i n))) (weight (flo (* step (aref b i)))))
          (declare (fixnum row target) (double-float weight))
          (for (j n)
            (let ((sum (aref carry j)) (place j))
              (declare (double-float sum) (fixnum place))
              (for (k s)
                (setq sum (flo (+ sum (* (aref m (fix (+ row k))) (aref l place))))
                      place (fix (+ place n))))
              (setf (aref in j) (flo (+ (aref state j) sum)))))
          (setf (aref in n) (flo (+ time (* (aref c i) step))))
          (funcall field in rates)
          (for (j n)
            (let* ((new (flo (* weight (aref rates j)))) (place (fix (+ target j)))
                   (change (flo (abs (- new (aref l place)))))
                   (size (flo (+ (abs (aref state j)) (abs new)))))
              (declare (double-float new change size) (fixnum place))
              (setf (aref l place) new)
              (when (> change (flo (* worst size))) (setq worst (if (> size 0d0) (flo (/ change size)) 1d200)))))))
      worst)))

(defun take-increments (march)
  (with-gauss (march)
    (for (j n)
      (let ((sum 0d0) (place j))
        (declare (double-float sum) (fixnum place))
        (for (k s)
          (setq sum (flo (+ sum (aref l place)))
                place (fix (+ place n))))
        (add-compensated state carry j sum)))
    nil))

;;; The method

(defun stages-of-gauss (options)
  (let ((given (assoc 'maxima::$stages options))) (if given (cdr given) 8)))

(defun trouble-of-gauss (options)
  (let ((stages (stages-of-gauss options)))
    (if (typep stages '(integer 1 8))
        (step-size-trouble "gauss" options)
        (format nil "stages must be an integer from 1 to 8, found ~a" (one-line stages)))))

(register-integrator "gauss"
                     :options '("step_size" "stages")
                     :check #'trouble-of-gauss
                     :preserves '("two_form")
                     :module "motion/constant_forms"
                     :function "anmech_constant_form_prepared"
                     :run (lambda (task)
                            (let ((s (stages-of-gauss (task-options task))))
                              (motion-of-equal-steps
                               task
                               (lambda (problem start step)
                                 (marching-walker problem (lambda () (new-gauss problem s)) #'gauss-steps start step))
                               :projecting t))))
