;;; anmech: explicit compositions of orders 2, 4, 6 and 8 for equations that part in two, with steps of equal length.
;;;
;;; It registers itself as method = composition.  Where the states are two groups, and the rates of each are functions
;;; of the other group only, as in Hamilton's equations of T(p) + V(q), the motion of one group while the other stands
;;; still is known: a step is a symmetric sequence of such moves.  All methods are explicit, symmetric, and symplectic
;;; for Hamilton's equations.  What depends on what is read off the program; time goes with the group whose rates do not
;;; depend on it.
;;;
;;; Few equations are written out as a loop over the steps with all states in registers, and compiled; of others the
;;; compiled field is called.
;;;
;;; Literature: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed. 2006, V.3.  Coefficients of
;;; order 4: S. Blanes, P. C. Moan, J. Comput. Appl. Math. 142 (2002) 313-330, S6; of orders 6 and 8: W. Kahan,
;;; R.-C. Li, Math. Comput. 66 (1997) 1089-1099, 9 and 17 stages.

(in-package :anmech)
(needs "session/texts" "arithmetic/floats" "numerics/codegen" "numerics/equal_steps"
       "numerics/integration" "numerics/marching" "numerics/methods" "numerics/model" "numerics/motion"
       "numerics/progress" "numerics/sharing")

;;; Sequences

(defun mirrored (half middle) (append half (list middle) (reverse half)))

(defun sequence-of-leaps (lengths)
  "Moves of the first group and of the second one, in turns, of leaps of these LENGTHS."
  (values (loop for (before after) on (cons 0d0 (append lengths '(0d0)))
                while after collect (* 0.5d0 (+ before after)))
          lengths))

(defun moves-of-order (order)
  "The parts of a step by which the first group moves, and the second: of this one less."
  (ecase order
    (2 (sequence-of-leaps '(1d0)))
    (4 (let ((a '(0.0792036964311957d0 0.353172906049774d0 -0.0420650803577195d0))
             (b '(0.209515106613362d0 -0.143851773179818d0)))
         (values (mirrored a (- 1d0 (* 2d0 (reduce #'+ a))))
                 (let ((last (- 0.5d0 (reduce #'+ b)))) (append b (list last last) (reverse b))))))
    (6 (sequence-of-leaps (mirrored '(0.39216144400731413928d0 0.33259913678935943860d0 -0.70624617255763935981d0
                                      0.082213596293550800231d0)
                                    0.79854399093482996340d0)))
    (8 (sequence-of-leaps (mirrored '(0.13020248308889008088d0 0.56116298177510838456d0 -0.38947496264484728641d0
                                      0.15884190655515560090d0 -0.39590389413323757734d0 0.18453964097831570709d0
                                      0.25837438768632204729d0 0.29501172360931029887d0)
                                    -0.60550853383003451170d0)))))

;;; What depends on what

(defun dependencies (program count)
  "For each result of PROGRAM the list of those of the first COUNT inputs that it depends on."
  (let* ((instructions (program-instructions program)) (depend (make-array (length instructions))))
    (flet ((inputs-of (operand)
             (cond ((integerp operand) (svref depend operand))
                   ((and (consp operand) (eq :input (car operand)) (< (cdr operand) count)) (list (cdr operand))))))
      (dotimes (k (length instructions))
        (setf (svref depend k)
              (reduce #'union (mapcar #'inputs-of (rest (aref instructions k))) :initial-value '())))
      (mapcar #'inputs-of (program-results program)))))

(defun rates-depend (model)
  "For each rate the states and the time (as the number of states) that it depends on."
  (let* ((n (model-dimension model)) (found (dependencies (model-program model) (1+ n))) (solved (model-solved model)))
    (if (model-arrangement model)
        (let ((all (reduce #'union found)))
          (append (mapcar #'list (model-places model)) (loop repeat (- n solved) collect all)))
        found)))

(defun groups-of-states (depend n)
  "A vector of 0 and 1, the group of each state, or the number of a state that prevents that."
  (let ((groups (make-array n :initial-element nil)))
    (labels ((neighbours (i)
               (union (remove n (nth i depend)) (loop for k below n when (member i (nth k depend)) collect k)))
             (paint (i group)
               (cond ((null (svref groups i))
                      (setf (svref groups i) group)
                      (dolist (j (neighbours i)) (paint j (- 1 group))))
                     ((/= group (svref groups i)) (return-from groups-of-states i)))))
      (dotimes (i n groups) (unless (svref groups i) (paint i 0))))))

(defun separated-groups (model)
  "The groups, time not among what the first one's rates depend on; or a complaint."
  (let* ((n (model-dimension model)) (depend (rates-depend model)) (groups (groups-of-states depend n)))
    (when (model-surfaces model) (complain "method = composition takes no equations with kinks"))
    (unless (vectorp groups)
      (complain "method = composition needs states of two groups, the rates of each functions of the other group only, ~
                 as for T(p) + V(q), which ~a prevents; method = gauss takes any system"
                (typed-name (nth groups (model-states model)))))
    (flet ((timed-p (group) (loop for list in depend for i from 0
                                    thereis (and (= group (svref groups i)) (member n list)))))
      (cond ((not (timed-p 0)) groups)
            ((timed-p 1) (complain "method = composition needs rates of which one group does not depend on time; ~
                                    method = gauss takes any system"))
            (t (map 'vector (lambda (group) (- 1 group)) groups))))))

;;; Written out

(defparameter *most-written-out* 400 "Programs of so many instructions are.")

(defun marked-instructions (program places)
  "Flags of the instructions that the results at PLACES need."
  (let* ((instructions (program-instructions program)) (needed (make-array (length instructions) :initial-element nil)))
    (labels ((note (operand)
               (when (and (integerp operand) (not (svref needed operand)))
                 (setf (svref needed operand) t)
                 (mapc #'note (rest (aref instructions operand))))))
      (loop for result in (program-results program) for k from 0 when (member k places) do (note result)))
    needed))

(defun loop-form (program n inputs groups)
  "Code of a function (state carry in count time step first second) that takes COUNT steps."
  (flet ((names (text count)
           (coerce (loop for i below count collect (make-symbol (format nil "~a~d" text i))) 'vector)))
    (let ((states (names "X" n)) (carries (names "E" n)) (others (names "P" (- inputs n 1)))
          (values (names "V" (length (program-instructions program)))))
      (labels ((operand-form (operand)
                 (cond ((null operand) nil)
                       ((integerp operand) (svref values operand))
                       ((eq :input (car operand))
                        (let ((place (cdr operand)))
                          (cond ((< place n) (svref states place))
                                ((= place n) 'now)
                                (t (svref others (- place n 1))))))
                       (t (number-of-operand operand))))
               (move (group)
                 (let* ((places (loop for i below n when (= group (svref groups i)) collect i))
                        (needed (marked-instructions program places))
                        (bindings (loop for (operation a b) across (program-instructions program)
                                        for k from 0
                                        when (svref needed k)
                                          collect (list (svref values k)
                                                        (guarded-form operation (operand-form a) (operand-form b) k)))))
                   `(let* (,@bindings)
                      (declare (double-float ,@(mapcar #'first bindings)))
                      ,@(loop for i in places
                              for x = (svref states i)
                              for e = (svref carries i)
                              for rate = (operand-form (nth i (program-results program)))
                              collect `(let* ((sum (flo (+ (* part ,rate) ,e)))
                                              (new (flo (+ ,x sum))) (back (flo (- new ,x))))
                                         (declare (double-float sum new back))
                                         (setq ,e (flo (+ (- ,x (- new back)) (- sum back)))
                                               ,x new)))))))
        `(lambda (guards)
           (declare (ignorable guards))
           (lambda (state carry in count time step first second)
             (declare (type (simple-array double-float (*)) state carry in first second) (ignorable in)
                      (fixnum count) (double-float time step) ,*fast-code*)
             (let (,@(loop for i below n collect `(,(svref states i) (aref state ,i)))
                   ,@(loop for i below n collect `(,(svref carries i) (aref carry ,i)))
                   ,@(loop for k below (- inputs n 1) collect `(,(svref others k) (aref in ,(+ n 1 k))))
                   (now time) (moves (length second)))
               (declare (double-float now ,@(coerce states 'list) ,@(coerce carries 'list) ,@(coerce others 'list))
                        (ignorable now ,@(coerce others 'list)) (fixnum moves))
               (for (k count)
                 (for (i (fix (+ moves 1)))
                   (let ((part (flo (* step (aref first i)))))
                     (declare (double-float part))
                     ,(move 0)
                     (setq now (flo (+ now part))))
                   (when (< i moves)
                     (let ((part (flo (* step (aref second i)))))
                       (declare (double-float part))
                       ,(move 1)))))
               ,@(loop for i below n
                       collect `(setf (aref state ,i) ,(svref states i) (aref carry ,i) ,(svref carries i)))
               nil)))))))

(defun compiled-loop (program n inputs groups)
  (funcall (quietly-compiled (loop-form program n inputs groups)) (program-guards program)))

(defun written-out-steps (model groups first second)
  "A function as MARCHING-WALKER wants it."
  (let* ((n (model-dimension model))
         (advance (compiled-before (model-equations model) (model-inputs model)
                                   (list :composition (coerce groups 'list))
                                   (lambda (equations)
                                     (declare (ignore equations))
                                     (compiled-loop (model-program model) n (length (model-inputs model)) groups))))
         (moves (length second)))
    (lambda (march count time step)
      (incf (march-cost march) (* moves count))
      (funcall (the function advance) (march-state march) (march-carry march) (march-in march) count time step first
               second))))

;;; By the field

(defun called-steps (field n groups first second)
  (declare (type (simple-array double-float (*)) first second) (fixnum n) (type function field))
  (let ((rates (zeros n)) (moves (length second)) (now 0d0))
    (declare (double-float now) (type (simple-array double-float (*)) rates) (fixnum moves))
    (labels ((move (march group part)
               (declare (double-float part))
               (let ((in (march-in march)) (state (march-state march)) (carry (march-carry march)))
                 (declare (type (simple-array double-float (*)) in state carry))
                 (for (i n) (setf (aref in i) (aref state i)))
                 (setf (aref in n) now)
                 (funcall field in rates)
                 (for (i n)
                   (when (eql group (svref groups i))
                     (add-compensated state carry i (* part (aref rates i)))))))
             (take-step (march time step)
               (declare (double-float time step))
               (setq now time)
               (dotimes (i (1+ moves))
                 (move march 0 (* step (aref first i)))
                 (setq now (+ now (* step (aref first i))))
                 (when (< i moves) (move march 1 (* step (aref second i)))))))
      (lambda (march count time step)
        (incf (march-cost march) (* moves count))
        (dotimes (k count nil) (take-step march (+ time (* k step)) step))))))

;;; The method

(defun order-of-composition (options)
  (let ((given (assoc 'maxima::$order options))) (if given (cdr given) 4)))

(defun trouble-of-composition (options)
  (let ((order (order-of-composition options)))
    (if (member order '(2 4 6 8))
        (step-size-trouble "composition" options)
        (format nil "order must be 2, 4, 6 or 8, found ~a" (one-line order)))))

(defun composition-motion (task)
  (let* ((start (get-internal-real-time)) (problem (task-problem task)) (model (problem-model problem))
         (groups (separated-groups model)))
    (multiple-value-bind (first second) (moves-of-order (order-of-composition (task-options task)))
      (let* ((first (coerce first 'double-array)) (second (coerce second 'double-array))
             (written-out (and (null (model-arrangement model))
                               (<= (length (program-instructions (model-program model))) *most-written-out*)
                               (written-out-steps model groups first second)))
             (seconds (seconds-since start))
             (motion (motion-of-equal-steps
                      task
                      (lambda (problem start step)
                        (marching-walker problem (lambda () nil)
                                         (or written-out
                                             (called-steps (problem-field problem) (problem-n problem) groups first
                                                           second))
                                         start step))
                      :projecting t)))
        (incf (motion-compile-seconds motion) seconds)
        motion))))

(register-integrator "composition"
                     :all-states t
                     :options '("step_size" "order")
                     :check #'trouble-of-composition
                     :preserves '("two_form")
                     :module "motion/constant_forms"
                     :function "anmech_constant_form_prepared"
                     :run #'composition-motion)
