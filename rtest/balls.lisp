;;;; balls.lisp: what rtest_rigorous.mac asks.
;;;;
;;;;   balls_outside(count)    of so many balls of each operation, taken by chance with 12, 40 and 100 binary places:
;;;;                           those that do not hold what Maxima's bigfloats give at a point of the operands, as texts
;;;;   balls_are_narrow()      the operations whose ball of a point is wider than a hundred units

(in-package :anmech)

(mapc #'load-kernel '("numerics/ball_functions" "numerics/long_numbers"))

(defvar *chance* 1)

(defun by-chance (below)
  (setq *chance* (mod (* 16807 *chance*) 2147483647))
  (mod (floor *chance* 7) below))

(defun ball-by-chance ()
  (let* ((size (ash 1 (+ *ball-bits* (by-chance 5) -3))) (middle (floor (* size (- (by-chance 2001) 1000)) 1000)))
    (ball middle (case (by-chance 4)
                   (0 0)
                   (1 (by-chance 10))
                   (2 (floor size (+ 16 (by-chance 90))))
                   (t (floor (* size (by-chance 100)) 100))))))

(defun point-by-chance (ball)
  "A rational number in BALL, often one of its ends."
  (let ((part (case (by-chance 3) (0 -1) (1 1) (t (/ (- (by-chance 2001) 1000) 1000)))))
    (/ (+ (ball-middle ball) (* part (ball-radius ball))) (ash 1 *ball-bits*))))

(defun operands-by-chance (operation)
  (cons (ball-by-chance)
        (case operation
          ((:add :subtract :multiply :divide :atan2) (list (ball-by-chance)))
          (:expt (list (if (zerop (by-chance 2)) (ball-of (/ (- (by-chance 9) 4) 2)) (ball-by-chance)))))))

(defun outside-p (operation operands)
  "Whether the ball of OPERATION does not hold a value; where it has none everywhere, there is no ball."
  (let ((found (handler-case (apply #'ball-operation operation operands) (domain-violation () nil))))
    (and found
         (let ((value (if (and (eq operation :expt) (integerp (exact-exponent (second operands))))
                          (expt (point-by-chance (first operands)) (exact-exponent (second operands)))
                          (apply #'long-operation operation (+ 60 *ball-bits*)
                                 (mapcar #'point-by-chance operands)))))
           (or (null value)
               (> (abs (- (* value (ash 1 *ball-bits*)) (ball-middle found)))
                  (+ (ball-radius found) (expt 2 -20))))))))

(maxima::defmfun maxima::$balls_outside (count)
  (setq *chance* 4711)
  (maxima-list
   (loop for bits in '(12 40 100)
         append (let ((*ball-bits* bits))
                  (loop for (operation) in *ball-operations*
                        append (loop repeat count
                                     for operands = (operands-by-chance operation)
                                     when (outside-p operation operands)
                                       collect (format nil "~(~a~) ~a ~a" operation bits operands)))))))

(maxima::defmfun maxima::$balls_are_narrow ()
  (let ((*ball-bits* 80))
    (maxima-list
     (loop for (operation) in *ball-operations*
           for a = (ball-of (if (eq operation :acosh) 7/4 3/7))
           for ball = (if (member operation '(:add :subtract :multiply :divide :expt :atan2))
                          (ball-operation operation a (ball-of 2/3))
                          (ball-operation operation a))
           when (> (ball-radius ball) 100) collect (format nil "~(~a~)" operation)))))
