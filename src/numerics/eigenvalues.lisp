;;; anmech: the eigenvalues of a real matrix of doubles.
;;;
;;; By QR steps with two shifts on the matrix in Hessenberg's form, after its rows and columns have been scaled to like
;;; sizes: they are eigenvalues of a matrix that differs from the given one by rounding.  So multiple ones are known to
;;; as many digits as the matrix determines; the roots of its characteristic polynomial, whose coefficients are rounded,
;;; would not be, even of the unit matrix.  Maxima's own, dgeev of its package lapack, takes minutes to load.
;;;
;;; Entry points: $anmech_eigenvalues.
;;;
;;; Literature: J. G. F. Francis, Comput. J. 4 (1961) 265 and (1962) 332; B. N. Parlett, C. Reinsch, Numer. Math. 13
;;; (1969) 293; G. H. Golub, C. F. Van Loan, Matrix Computations (2013), section 7.5.

(in-package :anmech)
(needs "numerics/evaluation")

(defun balance (a n)
  "Scales rows and columns of A by powers of 2, inversely to one another, until those of an index have like sizes."
  (loop for changed = nil
        repeat 100
        do (dotimes (i n)
             (let ((row 0d0) (column 0d0) (factor 1d0))
               (dotimes (k n)
                 (unless (= k i)
                   (incf row (abs (aref a i k)))
                   (incf column (abs (aref a k i)))))
               (unless (or (zerop row) (zerop column))
                 (let ((size (+ row column)))
                   (loop while (< column (/ row 2))
                         do (setf factor (* 2 factor) column (* 2 column) row (/ row 2)))
                   (loop while (> column (* 2 row))
                         do (setf factor (/ factor 2) column (/ column 2) row (* 2 row)))
                   (when (< (+ row column) (* 0.95d0 size))
                     (setf changed t)
                     (dotimes (k n)
                       (setf (aref a i k) (/ (aref a i k) factor)))
                     (dotimes (k n)
                       (setf (aref a k i) (* (aref a k i) factor))))))))
        while changed))

(defun reflect (a vector place rows columns)
  "A becomes H A H, in the COLUMNS [from, to) of its rows and the ROWS of its columns that matter.  H = 1 - 2 v v^T is
the reflection that takes VECTOR, which stands for components from PLACE on, to a multiple of the first unit vector."
  (let* ((scale (reduce #'max (mapcar #'abs vector)))
         (x (if (zerop scale) vector (mapcar (lambda (e) (/ e scale)) vector)))
         (length (sqrt (reduce #'+ (mapcar #'* x x))))
         (v (cons (+ (first x) (if (minusp (first x)) (- length) length)) (rest x)))
         (square (reduce #'+ (mapcar #'* v v))))
    (unless (or (zerop square) (every #'zerop (rest x)))
      (flet ((take-away (from to entry)
               (loop for j from (first from) below (second to)
                     do (let ((part (/ (* 2 (loop for e in v for i from place sum (* e (funcall entry i j)))) square)))
                          (loop for e in v
                                for i from place
                                do (funcall entry i j (* part e)))))))
        (take-away columns columns (lambda (i j &optional (change 0d0)) (decf (aref a i j) change)))
        (take-away rows rows (lambda (i j &optional (change 0d0)) (decf (aref a j i) change)))))))

(defun hessenberg (a n)
  "A becomes a similar matrix that has nothing below its first subdiagonal."
  (loop for k from 0 below (- n 2)
        do (reflect a (loop for i from (1+ k) below n collect (aref a i k)) (1+ k) (list 0 n) (list k n))
           (loop for i from (+ k 2) below n
                 do (setf (aref a i k) 0d0))))

(defun eigenvalues-of-block (a b c d)
  "Of the matrix ((A B) (C D)): two pairs of real and imaginary part."
  (let* ((half (/ (- a d) 2)) (square (+ (* half half) (* b c))))
    (if (minusp square)
        (let ((imaginary (sqrt (- square))))
          (list (list (+ d half) imaginary) (list (+ d half) (- imaginary))))
        (let ((z (if (minusp half) (- half (sqrt square)) (+ half (sqrt square)))))
          (list (list (+ d z) 0d0) (list (if (zerop z) d (- d (/ (* b c) z))) 0d0))))))

(defun shifted-step (a low high one two product)
  "A step on the block of A from LOW to HIGH, of three rows at least, whose shifts are the eigenvalues of a matrix with
ONE and TWO in its diagonal and that PRODUCT of the other entries.  Only differences of what is alike are formed: where
all eigenvalues are nearly the same, their own would be lost in sums and products of them."
  (let* ((h00 (aref a low low)) (h10 (aref a (1+ low) low)) (less-one (- one h00)) (less-two (- two h00))
         (vector (list (+ (/ (- (* less-one less-two) product) h10) (aref a low (1+ low)))
                       (- (aref a (1+ low) (1+ low)) h00 less-one less-two)
                       (aref a (+ low 2) (1+ low)))))
    (loop for k from low below high
          do (when (> k low)
               (setf vector (loop for i from k to (min high (+ k 2)) collect (aref a i (1- k)))))
             (reflect a vector k (list low (1+ (min high (+ k 3)))) (list (max low (1- k)) (1+ high)))
             (when (> k low)
               (loop for i from (1+ k) to (min high (+ k 2))
                     do (setf (aref a i (1- k)) 0d0))))))

(defun eigenvalues (a n)
  "List of pairs of real and imaginary part; A is an array of N rows and columns, which is used up.  Nil if a hundred
steps for one do not find it."
  (balance a n)
  (hessenberg a n)
  (let ((found '()) (high (1- n)) (steps 0)
        (size (loop for i below n maximize (loop for j below n sum (abs (aref a i j))))))
    (loop while (>= high 0)
          do (let ((low (loop for k from high above 0
                              do (let ((near (+ (abs (aref a k k)) (abs (aref a (1- k) (1- k))))))
                                   (when (<= (abs (aref a k (1- k)))
                                             (* double-float-epsilon (if (zerop near) size near)))
                                     (setf (aref a k (1- k)) 0d0)
                                     (return k)))
                              finally (return 0))))
               (flet ((entry (i j) (aref a (+ high i) (+ high j))))
                 (cond ((= low high)
                        (push (list (entry 0 0) 0d0) found)
                        (setf high (1- high) steps 0))
                       ((= low (1- high))
                        (setf found (append (eigenvalues-of-block (entry -1 -1) (entry -1 0) (entry 0 -1) (entry 0 0))
                                            found)
                              high (- high 2)
                              steps 0))
                       ((> (incf steps) 100) (return-from eigenvalues nil))
                       ((zerop (mod steps 10))                       ; shifts that lead out of a circle of steps
                        (let ((shift (+ (abs (entry 0 -1)) (abs (entry -1 -2)))))
                          (shifted-step a low high (* 0.75d0 shift) (* 0.75d0 shift) (* -0.4375d0 shift shift))))
                       (t (shifted-step a low high (entry 0 0) (entry -1 -1) (* (entry -1 0) (entry 0 -1))))))))
    found))

(maxima::defmfun maxima::$anmech_eigenvalues (matrix)
  "anmech_eigenvalues(matrix): of a square matrix of real numbers, a list of [real part, imaginary part]; false if they
are not found."
  (let* ((rows (mapcar #'rest (rest matrix))) (n (length rows)) (found nil))
    (setf found (eigenvalues (make-array (list n n) :initial-contents
                                         (mapcar (lambda (row) (coerce (exact-doubles row) 'list)) rows))
                             n))
    (and found (cons '(maxima::mlist maxima::simp) (mapcar #'numbers-list found)))))
