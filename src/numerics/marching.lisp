;;; anmech: what methods of equal steps share that keep the roundings of their sums.
;;;
;;; A *march* is a state, what its sums have lost to rounding so far (the *carry*), and the number of steps taken.  Each
;;; step adds to the state and the carry together, so that the error of rounding of many steps is that of the single
;;; increments: it grows like a square root, not with the number of steps (Brouwer's law).  With a projection every step
;;; ends on what is constant.
;;;
;;; Entry points: the structure MARCH; ADD-COMPENSATED, MARCHING-WALKER.
;;;
;;; Literature: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed. 2006, VIII.5; E. Hairer,
;;; R. I. McLachlan, A. Razakarivony, Achieving Brouwer's law with implicit Runge-Kutta methods, BIT 48 (2008) 231-243.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats" "numerics/equal_steps" "numerics/integration" "numerics/projection")

(defstruct march
  (n 0 :type fixnum)
  (in nil :type double-array)         ; what the field sees
  (state nil :type double-array)
  (carry nil :type double-array)
  (taken 0 :type fixnum)
  (cost 0 :type fixnum)
  (projector nil)
  work)                               ; the method's own

(defmacro add-compensated (state carry i increment)
  "Add INCREMENT to entry I of STATE, with what was lost before; what is lost now goes to CARRY."
  (let ((old (gensym)) (sum (gensym)) (new (gensym)) (back (gensym)))
    `(let* ((,old (aref ,state ,i)) (,sum (flo (+ ,increment (aref ,carry ,i)))) (,new (flo (+ ,old ,sum)))
            (,back (flo (- ,new ,old))))
       (declare (double-float ,old ,sum ,new ,back))
       ;; exact whichever of both is larger
       (setf (aref ,carry ,i) (flo (+ (- ,old (- ,new ,back)) (- ,sum ,back)))
             (aref ,state ,i) ,new))))

(defconstant +projection-unit+ 1d-6 "Of a state, the part in which the distance to what is constant is measured.")

(defun new-march (problem start make-work)
  "A march of PROBLEM from START; MAKE-WORK is a function without arguments."
  (let ((n (problem-n problem)) (projection (problem-projection problem)))
    (make-march :n n :in (copy-seq start) :state (subseq start 0 n) :carry (zeros n) :work (funcall make-work)
                :projector (and projection
                                (make-projector projection start n
                                                (map 'double-array (lambda (x) (* +projection-unit+ (max (abs x) 1d-3)))
                                     (subseq start 0 n))
                                                +projection-unit+)))))

(defun march-until (march steps count t0 step)
  "Go on until COUNT steps of the length STEP are taken since T0: nil, or what has prevented it.  STEPS is a function
(march count time step) that takes so many steps, if there is no projection; one otherwise: nil, or the trouble."
  (declare (type function steps))
  (handler-case
      (if (march-projector march)
          (loop while (< (march-taken march) count)
                do (let ((trouble (funcall steps march 1 (+ t0 (* step (march-taken march))) step)))
                     (when trouble (return trouble))
                     (incf (march-taken march))
                     (funcall (the function (march-projector march)) (march-state march)
                              (+ t0 (* step (march-taken march))))))
          (or (funcall steps march (- count (march-taken march)) (+ t0 (* step (march-taken march))) step)
              (progn (setf (march-taken march) count) nil)))
    ((or domain-violation arithmetic-error) (condition) condition)))

(defun marching-walker (problem make-work steps start step)
  "The walker of equal_steps.lisp of a method whose steps are taken by STEPS, see MARCH-UNTIL."
  (let ((march (new-march problem start make-work)) (t0 (aref start (problem-n problem))))
    (make-walker :advance (lambda (count) (march-until march steps count t0 step))
                 :taken (lambda () (march-taken march))
                 :state (lambda (time out)
                          (declare (ignore time))
                          (and (every (lambda (x) (<= (abs x) +largest-size+)) (march-state march))
                               (replace out (march-state march))))
                 :cost (lambda () (march-cost march))
                 :value (lambda (states time later out)
                          (value-by-marching problem make-work steps start states time later step out)))))

(defun value-by-marching (problem make-work steps start states time later step out)
  "The states at LATER, by steps from STATES at TIME on; the last one is as short as need be."
  (let ((count (max 0 (floor (* (- later time) (+ 1d0 1d-13)) step))) (found (copy-seq states)) (n (problem-n problem)))
    (flet ((go-on (from count step)
             (let* ((begin (replace (copy-seq start) found)) (march (progn (setf (aref begin n) from)
                                                                           (new-march problem begin make-work))))
               (when (march-until march steps count from step)
                 (complain "the equations of a step before time ~a were not solved" (maxima-text later)))
               (replace found (march-state march)))))
      (when (plusp count) (go-on time count step))
      (let* ((from (+ time (* count step))) (left (- later from)))
        (unless (< (abs left) (* 1d-12 (abs step))) (go-on from 1 left)))
      (replace out found))))
