;;; anmech: what rounding does, done on purpose.
;;;
;;; The second of two integrations of a motion sees every state, the time, and the entries of linear equations changed
;;; by one unit in the last place: so what both differ by holds what rounding does in the end (accuracy.lisp).
;;;
;;; Entry points: NOISE-FACTORS, NOISY-FIELD, NOISY-SYSTEM.

(in-package :anmech)
(needs "arithmetic/floats")

(defun noise-factors (start other n direction)
  "By what a field sees every state changed: a unit in the last place, in the direction, if there is one, from START to
OTHER, where the same is rounded otherwise; or, if DIRECTION is -1, in the opposite one."
  (let ((factors (zeros n)))
    (dotimes (i n factors)
      (let* ((difference (- (abs (aref other i)) (abs (aref start i))))
             (side (if (or (plusp difference) (and (zerop difference) (evenp i))) 1 -1)))
        (setf (aref factors i) (+ 1d0 (* 2.3d-16 direction side)))))))

(defun noisy-field (field factors size)
  "FIELD, whose input has SIZE numbers, with the states multiplied by FACTORS, and the time moved by at most a unit in
the last place, at random: as it is rounded, too."
  (declare (type function field) (type (simple-array double-float (*)) factors) (fixnum size))
  (let ((n (length factors)) (seen (zeros size)) (seed 1))
    (declare (type (simple-array double-float (*)) seen) (fixnum n seed))
    (lambda (in out)
      (declare (type (simple-array double-float (*)) in out))
      (with-fast-arithmetic
        (let ((seen seen) (factors factors) (n n) (size size) (new-seed seed))          ; a closure reads anew each time
          (declare (type (simple-array double-float (*)) seen factors) (fixnum n size new-seed))
          (for (i n) (setf (aref seen i) (flo (* (aref factors i) (aref in i)))))
          (for (i size n) (setf (aref seen i) (aref in i)))
          (setq new-seed (the fixnum (logand 65535 (the fixnum (+ 13849 (the fixnum (* 25173 new-seed))))))
                seed new-seed)
          (setf (aref seen n) (flo (* (aref seen n)
                                      (+ 1d0 (if (< new-seed 22000) -2.3d-16 (if (< new-seed 44000) 0d0 2.3d-16))))))
          (funcall field seen out)
          nil)))))

(defun noisy-system (system count signs direction)
  "SYSTEM with COUNT results changed by a unit in the last place: those of the matrix, which are the first, by SIGNS,
the others by chance."
  (declare (type function system) (fixnum count))
  (let ((factors (zeros count)) (seed 1))
    (declare (fixnum seed) (type (simple-array double-float (*)) factors))
    (dotimes (k count)
      (setq seed (mod (* 16807 seed) 2147483647))
      (setf (aref factors k)
            (+ 1d0 (* 2.3d-16 direction (or (pop signs) (if (logbitp 10 seed) 1 -1))))))
    (lambda (in work)
      (declare (type (simple-array double-float (*)) work))
      (funcall system in work)
      (with-fast-arithmetic
        (for (k count) (setf (aref work k) (flo (* (aref factors k) (aref work k)))))
        nil))))
