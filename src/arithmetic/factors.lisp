;;; anmech: triangular factors of a matrix of doubles, real or complex, which serve many right-hand sides.
;;;
;;; Matrices stand by rows; of complex ones real and imaginary parts in two arrays, for no Lisp here keeps arrays of
;;; complex numbers without boxing them on the way.  The pivot is the largest entry of its column.
;;;
;;; Entry points: FACTOR-REAL, SOLVE-REAL; FACTOR-COMPLEX, SOLVE-COMPLEX.
;;;
;;; Literature: G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed. 2013, 3.4.

(in-package :anmech)
(needs "arithmetic/floats")

(declaim (ftype (function (fixnum t t) t) factor-real)
         (ftype (function (fixnum t t t) t) factor-complex solve-real)
         (ftype (function (fixnum t t t t t) t) solve-complex))

(defmacro exchange (array first second)
  `(let ((kept (aref ,array ,first)))
     (declare (double-float kept))
     (setf (aref ,array ,first) (aref ,array ,second)
           (aref ,array ,second) kept)))

(defmacro with-largest ((best size) (k n) measure &body body)
  "BODY where BEST is the row, not above K, for which MEASURE, a form in i, is largest, and SIZE that measure."
  `(let ((,best ,k) (,size 0d0))
     (declare (fixnum ,best) (double-float ,size))
     (for (i ,n ,k)
       (let ((candidate ,measure))
         (declare (double-float candidate))
         (when (> candidate ,size) (setq ,size candidate ,best i))))
     ,@body))

(defun factor-real (n a pivots)
  "A becomes its factors, PIVOTS, fixnums, the rows that were exchanged; nil if it is singular or not finite."
  (declare (fixnum n) (type (simple-array double-float (*)) a) (type (simple-array fixnum (*)) pivots))
  (with-fast-arithmetic
    (for (k n)
      (with-largest (best size) (k n) (flo (abs (aref a (fix (+ (* i n) k)))))
        (unless (< 0d0 size 1d300) (return-from factor-real nil))
        (setf (aref pivots k) best)
        (unless (= best k)
          (for (j n) (exchange a (fix (+ (* k n) j)) (fix (+ (* best n) j)))))
        (let ((inverse (flo (/ 1d0 (aref a (fix (+ (* k n) k)))))) (pivot-row (fix (* k n))))
          (declare (double-float inverse) (fixnum pivot-row))
          (setf (aref a (fix (+ pivot-row k))) inverse)
          (for (i n (fix (+ k 1)))
            (let* ((row (fix (* i n))) (factor (flo (* inverse (aref a (fix (+ row k)))))))
              (declare (fixnum row) (double-float factor))
              (setf (aref a (fix (+ row k))) factor)
              (unless (= factor 0d0)
                (for (j n (fix (+ k 1)))
                  (setf (aref a (fix (+ row j)))
                        (flo (- (aref a (fix (+ row j))) (* factor (aref a (fix (+ pivot-row j)))))))))))))) 
    t))

(defun solve-real (n a pivots b)
  "B becomes the solution; A and PIVOTS are those of FACTOR-REAL."
  (declare (fixnum n) (type (simple-array double-float (*)) a b) (type (simple-array fixnum (*)) pivots))
  (with-fast-arithmetic
    (for (k n)
      (let ((other (aref pivots k)))
        (declare (fixnum other))
        (unless (= other k) (exchange b k other))))
    (for (i n)
      (let ((row (fix (* i n))) (value (aref b i)))
        (declare (fixnum row) (double-float value))
        (for (j i) (setq value (flo (- value (* (aref a (fix (+ row j))) (aref b j))))))
        (setf (aref b i) value)))
    (do ((i (fix (- n 1)) (fix (- i 1))))
        ((< i 0) nil)
      (declare (fixnum i))
      (let ((row (fix (* i n))) (value (aref b i)))
        (declare (fixnum row) (double-float value))
        (for (j n (fix (+ i 1))) (setq value (flo (- value (* (aref a (fix (+ row j))) (aref b j))))))
        (setf (aref b i) (flo (* value (aref a (fix (+ row i))))))))))

(defmacro subtract-product (x y u v p q)
  "(x, y) becomes (x, y) - (u, v)(p, q), products of complex numbers."
  `(setf ,x (flo (- ,x (- (* ,u ,p) (* ,v ,q))))
         ,y (flo (- ,y (+ (* ,u ,q) (* ,v ,p))))))

(defun factor-complex (n re im pivots)
  "The same of the matrix RE + i IM."
  (declare (fixnum n) (type (simple-array double-float (*)) re im) (type (simple-array fixnum (*)) pivots))
  (with-fast-arithmetic
    (for (k n)
      (with-largest (best size) (k n)
          (flo (+ (abs (aref re (fix (+ (* i n) k)))) (abs (aref im (fix (+ (* i n) k))))))
        (unless (< 0d0 size 1d150) (return-from factor-complex nil))
        (setf (aref pivots k) best)
        (unless (= best k)
          (for (j n)
            (exchange re (fix (+ (* k n) j)) (fix (+ (* best n) j)))
            (exchange im (fix (+ (* k n) j)) (fix (+ (* best n) j)))))
        (let* ((pivot-row (fix (* k n))) (place (fix (+ pivot-row k)))
               (u (aref re place)) (v (aref im place)) (square (flo (+ (* u u) (* v v))))
               (p (flo (/ u square))) (q (flo (/ (- v) square))))
          (declare (fixnum pivot-row place) (double-float u v square p q))
          (setf (aref re place) p (aref im place) q)
          (for (i n (fix (+ k 1)))
            (let* ((row (fix (* i n))) (there (fix (+ row k)))
                   (s (aref re there)) (w (aref im there))
                   (f (flo (- (* s p) (* w q)))) (g (flo (+ (* s q) (* w p)))))
              (declare (fixnum row there) (double-float s w f g))
              (setf (aref re there) f (aref im there) g)
              (for (j n (fix (+ k 1)))
                (let ((here (fix (+ row j))) (above (fix (+ pivot-row j))))
                  (declare (fixnum here above))
                  (subtract-product (aref re here) (aref im here) f g (aref re above) (aref im above)))))))))
    t))

(defun solve-complex (n re im pivots x y)
  "X + i Y becomes the solution; the others are those of FACTOR-COMPLEX."
  (declare (fixnum n) (type (simple-array double-float (*)) re im x y) (type (simple-array fixnum (*)) pivots))
  (with-fast-arithmetic
    (for (k n)
      (let ((other (aref pivots k)))
        (declare (fixnum other))
        (unless (= other k) (exchange x k other) (exchange y k other))))
    (macrolet ((subtract-row (start end)
                 `(for (j ,end ,start)
                    (let ((place (fix (+ row j))))
                      (declare (fixnum place))
                      (subtract-product u v (aref re place) (aref im place) (aref x j) (aref y j))))))
      (for (i n)
        (let ((row (fix (* i n))) (u (aref x i)) (v (aref y i)))
          (declare (fixnum row) (double-float u v))
          (subtract-row 0 i)
          (setf (aref x i) u (aref y i) v)))
      (do ((i (fix (- n 1)) (fix (- i 1))))
          ((< i 0) nil)
        (declare (fixnum i))
        (let ((row (fix (* i n))) (u (aref x i)) (v (aref y i)))
          (declare (fixnum row) (double-float u v))
          (subtract-row (fix (+ i 1)) n)
          (let ((p (aref re (fix (+ row i)))) (q (aref im (fix (+ row i)))))
            (declare (double-float p q))
            (setf (aref x i) (flo (- (* u p) (* v q)))
                  (aref y i) (flo (+ (* u q) (* v p))))))))))
