;;; anmech: states moved to where what is constant has its value.
;;;
;;; Errors carry a motion off its constraints, and off its integrals; over many steps that adds up.  A *projection*
;;; holds such functions of the states, the time and the parameters, compiled together with their gradients.  A
;;; *projector* of it is a function (states time) that moves states in place to the nearest ones at which they have
;;; their values, by Newton's method; what it does depends on these states alone, so that a step taken again ends where
;;; it did.
;;;
;;; Entry points: the structure PROJECTION; SETTLED-PROJECTION, MAKE-PROJECTOR, WANDERING; $anmech_motion_projection.
;;;
;;; Literature: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed. 2006, IV.4; L. F. Shampine,
;;; Conservation laws and the numerical solution of ODEs, Computers & Mathematics with Applications 12B (1986) 1287.

(in-package :anmech)
(needs "arithmetic/floats" "numerics/codegen" "numerics/dag")

(defstruct (projection (:print-function print-dots))
  names                  ; texts, one for each function
  (count 0 :type fixnum)
  (constraints 0)        ; so many of them, the first ones, are to be 0, the others what they are at the beginning
  program                ; function (in out): the functions, their gradients by rows, and their derivatives by time
  (targets nil))         ; double array

(defun entries-of (projection n in)
  (let ((entries (make-array (* (projection-count projection) (+ 2 n)) :element-type 'double-float)))
    (funcall (the function (projection-program projection)) in entries)
    entries))

(defun settled-projection (projection start n)
  "PROJECTION with the targets of a motion of N states that begins at START, which is like the input of a field."
  (let ((settled (copy-projection projection))
        (targets (subseq (entries-of projection n start) 0 (projection-count projection))))
    (fill targets 0d0 :end (projection-constraints projection))
    (setf (projection-targets settled) targets)
    settled))

;;; The nearest states

(defparameter *most-newton-steps* 5)
(defparameter *far* 1d4 "No error of a step is so large, in units of its tolerance: the values are not to be had.")

(defun make-projector (projection start n absolute relative)
  "Of PROJECTION, settled.  Distances are measured in units, of each state, of ABSOLUTE and RELATIVE times its size;
they should be what an error may be.  The projector gives nil, and changes nothing, where it finds no such states
nearby."
  (let* ((count (projection-count projection))
         (program (projection-program projection))
         (in (copy-seq start))
         (entries (make-array (* count (+ 2 n)) :element-type 'double-float))
         (matrix (make-array (* count count) :element-type 'double-float))
         (right (make-array count :element-type 'double-float))
         (scales (make-array count :element-type 'double-float))
         (units (make-array n :element-type 'double-float))
         (enough (/ 1d-8 (max relative 1d-17))))
    (declare (double-float enough))
    (lambda (states time)
      (load-states n states time in absolute relative units)
      (loop repeat *most-newton-steps*
            do (funcall (the function program) in entries)
               (let ((distance (correct-states count n in entries (projection-targets projection) units matrix right
                                               scales)))
                 (declare (double-float distance))
                 (cond ((not (<= distance (the double-float *far*))) (return nil))
                       ((<= distance enough)                           ; what is left is of the order of its square
                        (return (take-states n in states)))))))))

(defun load-states (n states time in absolute relative units)
  "STATES and TIME to IN, and what the states are measured in to UNITS."
  (declare (fixnum n) (double-float time relative) (type (simple-array double-float (*)) states in absolute units))
  (with-fast-arithmetic
    (for (i n)
      (setf (aref in i) (aref states i)
            (aref units i) (flo (+ (aref absolute i) (* relative (abs (aref states i)))))))
    (setf (aref in n) time)
    nil))

(defun take-states (n in states)
  (declare (fixnum n) (type (simple-array double-float (*)) in states))
  (with-fast-arithmetic
    (for (i n) (setf (aref states i) (aref in i)))
    t))

(defun correct-states (count n in entries targets units matrix right scales)
  "One step of Newton's method for the states in IN, the smallest in UNITS; its largest part, 1d300 if there is none."
  (declare (fixnum count n)
           (type (simple-array double-float (*)) in entries targets units matrix right scales))
  (with-fast-arithmetic
    (let ((largest 0d0))
      (declare (double-float largest))
      (for (k count)
        (setf (aref right k) (flo (- (aref targets k) (aref entries k))))
        ;; gradients in units
        (let ((row (fix (+ count (* k n)))))
          (declare (fixnum row))
          (for (i n) (setf (aref entries (fix (+ row i))) (flo (* (aref units i) (aref entries (fix (+ row i)))))))))
      (for (k count)
        (for (l count)
          (let ((sum 0d0) (row (fix (+ count (* k n)))) (other (fix (+ count (* l n)))))
            (declare (double-float sum) (fixnum row other))
            (for (i n)
              (setq sum (flo (+ sum (* (aref entries (fix (+ row i))) (aref entries (fix (+ other i))))))))
            (setf (aref matrix (fix (+ l (* k count)))) sum))))
      (solve-dependent count matrix right scales)
      (for (i n)
        (let ((part 0d0))
          (declare (double-float part))
          (for (k count)
            (setq part (flo (+ part (* (aref right k) (aref entries (fix (+ count (+ i (* k n))))))))))
          (setf (aref in i) (flo (+ (aref in i) (* part (aref units i)))))
          (setq largest (if (<= (flo (abs part)) 1d300) (flo (max largest (abs part))) 1d300))))
      largest)))

;; Functions may depend on each other: an integral follows from constraints, or two have parallel gradients, like energy
;; and angular momentum on a circle.  Those that come first are met; the others are as they are.
(defconstant +dependent+ 1d-12 "The square of the sine of an angle between a gradient and others that is taken for 0.")

(defun solve-dependent (count matrix right scales)
  "RIGHT to a solution of MATRIX u = RIGHT, a matrix of products of gradients, which may be dependent; in order, what
depends on those before gets 0.  MATRIX is overwritten, SCALES with its diagonal."
  (declare (fixnum count) (type (simple-array double-float (*)) matrix right scales))
  (with-fast-arithmetic
    (flet ((place (k l) (declare (fixnum k l)) (fix (+ l (* k count)))))
      (for (k count) (setf (aref scales k) (aref matrix (place k k))))
      (for (k count)
        (let ((pivot (aref matrix (place k k))))
          (declare (double-float pivot))
          (if (> pivot (flo (* +dependent+ (aref scales k))))
              (for (l count (fix (+ k 1)))
                (let ((factor (flo (/ (aref matrix (place l k)) pivot))))
                  (declare (double-float factor))
                  (for (i count k)
                    (setf (aref matrix (place l i))
                          (flo (- (aref matrix (place l i)) (* factor (aref matrix (place k i)))))))
                  (setf (aref right l) (flo (- (aref right l) (* factor (aref right k)))))))
              (setf (aref scales k) -1d0))))
      ;; from the last one on
      (let ((k (fix (- count 1))))
        (declare (fixnum k))
        (loop
          (when (< k 0) (return nil))
          (if (< (aref scales k) 0d0)
              (setf (aref right k) 0d0)
              (let ((sum (aref right k)))
                (declare (double-float sum))
                (for (l count (fix (+ k 1)))
                  (setq sum (flo (- sum (* (aref matrix (place k l)) (aref right l))))))
                (setf (aref right k) (flo (/ sum (aref matrix (place k k)))))))
          (setq k (fix (- k 1))))))))

;;; What is no constant

(defparameter *wandering* 1d-8 "The part of its terms from which on the rate of a function is not taken for zero.")

(defun wandering (projection field in n)
  "The name of one that is no constraint and not constant at IN, where FIELD gives the rates; nil if there is none."
  (let* ((count (projection-count projection)) (entries (entries-of projection n in))
         (rates (make-array n :element-type 'double-float)))
    (funcall (the function field) in rates)
    (loop for name in (projection-names projection)
          for k from 0
          for terms = (cons (aref entries (+ count (* count n) k))
                            (loop for i below n collect (* (aref rates i) (aref entries (+ count (* k n) i)))))
          when (and (>= k (projection-constraints projection))
                    (> (abs (reduce #'+ terms)) (* *wandering* (reduce #'+ terms :key #'abs))))
            return name)))

(maxima::defmfun maxima::$anmech_motion_projection (names entries constraints inputs)
  "anmech_motion_projection([text, ...], entries, constraints, inputs): what a motion is to be projected onto.  The
entries are functions of the inputs, so many of them constraints; then their gradients, and their derivatives by time."
  (make-projection :names (rest names) :count (length (rest names)) :constraints constraints
                   :program (with-compilation-errors
                              (lambda () (nth-value 0 (compile-expressions (rest entries) (rest inputs)))))))
