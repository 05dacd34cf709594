;;; anmech: sets of states as parallelepipeds, and how a step carries them along (Lohner's method).
;;;
;;; A set is  c + D Q r:  a center, scales (powers of two, the sizes of states), an orthogonal matrix, and a box of
;;; which only the radii are kept.  A map that is p(c) + J (x - c) + e, with J in a matrix of balls, takes it to
;;; p(c) + J D Q r + e; the new Q is the orthogonal part of J D Q with its columns in the order of their lengths.
;;; Doubles find Q, as good as they can: any will do, because of the one that is chosen the inverse is enclosed in
;;; integers.
;;;
;;; Entry points: *FRAME-BITS*; UNIT-FRAME, MATRIX-IN-FRAME, RADII-OF-MAP, NEW-FRAME, RADII-IN-FRAME.
;;;
;;; Literature: R. J. Lohner, Enclosing the solutions of ordinary initial and boundary value problems, in: E. Kaucher
;;; et al. (eds.), Computerarithmetic (1987) 255-286; N. S. Nedialkov, K. R. Jackson, Reliable Computing 5 (1999)
;;; 289-310.

(in-package :anmech)
(needs "numerics/balls" "numerics/doubles")

(defparameter *frame-bits* 60 "The entries of an orthogonal matrix are integers in units of two to minus that.")

(defun unit-frame (n)
  "By rows, as are all matrices here."
  (let ((frame (make-array (* n n) :initial-element 0)))
    (dotimes (i n frame) (setf (svref frame (+ i (* i n))) (ash 1 *frame-bits*)))))

(defun shifted-ball (ball bits)
  "BALL times 2^BITS."
  (if (minusp bits)
      (ball-halved ball (- bits))
      (ball (ash (ball-middle ball) bits) (ash (ball-radius ball) bits))))

(defun matrix-in-frame (matrix frame from to n)
  "MATRIX, of balls, times the scales FROM and FRAME, over the scales TO: balls."
  (let ((scaled (make-array (* n n))) (product (make-array (* n n))))
    (dotimes (i n)
      (dotimes (j n)
        (setf (svref scaled (+ j (* i n)))
              (shifted-ball (svref matrix (+ j (* i n))) (- (svref from j) (svref to i))))))
    (dotimes (i n product)
      (dotimes (j n)
        (let ((middle 0) (radius 0))
          (dotimes (l n)
            (let ((ball (svref scaled (+ l (* i n)))) (entry (svref frame (+ j (* l n)))))
              (unless (eql entry 0)
                (incf middle (* entry (ball-middle ball)))
                (incf radius (* (abs entry) (ball-radius ball))))))
          (setf (svref product (+ j (* i n)))
                (ball (ash middle (- *frame-bits*)) (1+ (ceiling-shift radius *frame-bits*)))))))))

(defun radii-of-map (matrix radii n)
  "For each row of MATRIX, of balls, the largest size of its product with a vector of RADII."
  (let ((found (make-array n)))
    (dotimes (i n found)
      (setf (svref found i)
            (ceiling-shift (loop for j below n sum (* (ball-size (svref matrix (+ j (* i n)))) (svref radii j)))
                           *ball-bits*)))))

;;; The next frame

(defun scaled-column (matrix j radius n)
  "Column J of MATRIX times RADIUS as doubles of which the largest is about 1, and the binary logarithm of what they
were divided by; nil if it vanishes."
  (let* ((numbers (loop for i below n collect (* radius (ball-middle (svref matrix (+ j (* i n)))))))
         (largest (reduce #'max numbers :key #'abs)))
    (unless (zerop largest)
      (let ((shift (- (integer-length largest) 52)))
        (values (doubles (mapcar (lambda (number) (coerce (ash number (- shift)) 'double-float)) numbers)) shift)))))

(defun inner (a b)
  (declare (type (simple-array double-float (*)) a b))
  (let ((sum 0d0))
    (declare (double-float sum))
    (dotimes (i (length a) sum) (setq sum (+ sum (* (aref a i) (aref b i)))))))

(defun scale-vector (vector factor)
  (map-into vector (lambda (x) (* factor x)) vector))

(defun orthogonal-to (vector others)
  "VECTOR of length 1, then without its parts along OTHERS, twice, of length 1 again; nil if little is left."
  (scale-vector vector (/ (sqrt (inner vector vector))))
  (loop repeat 2
        do (dolist (other others)
             (let ((part (inner vector other)))
               (map-into vector (lambda (x y) (- x (* part y))) vector other)))
           (let ((length (sqrt (inner vector vector))))
             (when (< length 1d-8) (return-from orthogonal-to nil))
             (scale-vector vector (/ length))))
  vector)

(defun unit-vector (i n)
  (let ((vector (make-array n :element-type 'double-float :initial-element 0d0)))
    (setf (aref vector i) 1d0)
    vector))

(defun new-frame (matrix radii n)
  "An orthogonal matrix whose columns follow those of MATRIX times RADII, the longest first."
  (let ((columns (loop for j below n
                       for (vector shift) = (multiple-value-list (scaled-column matrix j (svref radii j) n))
                       when vector
                         collect (cons (+ shift (log (sqrt (inner vector vector)) 2d0)) vector)))
        (found '()))
    (loop for (nil . vector) in (sort columns #'> :key #'car)
          for column = (orthogonal-to vector found)
          do (when column (push column found)))
    (loop for i below n
          until (= (length found) n)
          do (let ((column (orthogonal-to (unit-vector i n) found)))
               (when column (push column found))))
    (frame-of-columns (reverse found) n)))

(defun frame-of-columns (columns n)
  (let ((frame (make-array (* n n))))
    (loop for column in columns
          for j from 0
          do (dotimes (i n)
               (setf (svref frame (+ j (* i n))) (round (rational (aref column i)) (/ (ash 1 *frame-bits*))))))
    frame))

(defun deviation-of-frame (frame n)
  "The largest sum of sizes in a row of 1 - Q'Q, in units of 2^-(2 *FRAME-BITS*)."
  (let ((one (ash 1 (* 2 *frame-bits*))))
    (loop for i below n
          maximize (loop for j below n
                         sum (abs (- (if (= i j) one 0)
                                     (loop for l below n
                                           sum (* (svref frame (+ i (* l n))) (svref frame (+ j (* l n)))))))))))

(defun transposed (frame n)
  (let ((other (make-array (* n n))))
    (dotimes (i n other)
      (dotimes (j n) (setf (svref other (+ j (* i n))) (svref frame (+ i (* j n))))))))

(defun radii-in-frame (frame matrix radii errors n)
  "The radii, in FRAME, of MATRIX times a box of RADII and of a box of ERRORS; nil if FRAME is not near an orthogonal
matrix.  Q'Q = 1 - E, so the inverse of Q is (1 + F) Q', where rows of F are at most e/(1 - e) if those of E are at most
e."
  (let* ((back (transposed frame n)) (deviation (deviation-of-frame frame n)) (one (ash 1 (* 2 *frame-bits*)))
         (turned (turned-matrix back matrix n)) (found (radii-of-map turned radii n)))
    (when (< deviation (ash one -10))
      (dotimes (i n)
        (incf (svref found i)
              (ceiling-shift (loop for j below n sum (* (abs (svref back (+ j (* i n)))) (svref errors j)))
                             *frame-bits*)))
      (let ((more (ceiling-quotient (* deviation (reduce #'max found)) (- one deviation))))
        (map 'vector (lambda (radius) (+ radius more)) found)))))

(defun turned-matrix (back matrix n)
  "BACK, of integers in units of frames, times MATRIX, of balls."
  (let ((product (make-array (* n n))))
    (dotimes (i n product)
      (dotimes (j n)
        (let ((middle 0) (radius 0))
          (dotimes (l n)
            (let ((ball (svref matrix (+ j (* l n)))) (entry (svref back (+ l (* i n)))))
              (incf middle (* entry (ball-middle ball)))
              (incf radius (* (abs entry) (ball-radius ball)))))
          (setf (svref product (+ j (* i n)))
                (ball (ash middle (- *frame-bits*)) (1+ (ceiling-shift radius *frame-bits*)))))))))
