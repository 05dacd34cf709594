;;; anmech: systems of linear equations in doubles.
;;;
;;; Entry points: SOLVE-LINEAR-IN-PLACE; SOLVE-SCALED, for a right-hand side anywhere in an array; FORM-OF-SOLUTION, for
;;; few equations in generated code.
;;;
;;; Elimination with the pivot that is largest in proportion to its row. A matrix counts as singular when a pivot is
;;; negligible against the entries above it, all measured in units of their rows: such a pivot is what rounding left of
;;; numbers that cancelled. So the units of an unknown or of an equation do not decide what counts as singular.  Most
;;; systems are small: of up to four equations the elimination is written out.
;;;
;;; Literature: G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed. 2013, 3.4 and 3.5.2.

(in-package :anmech)
(needs "arithmetic/floats")

;; told beforehand, GCL passes the arguments unboxed
(declaim (ftype (function (fixnum t t) t) measure-rows)
         (ftype (function (fixnum t t fixnum t fixnum fixnum) t) exchange-rows)
         (ftype (function (fixnum t t fixnum t) t) eliminate)
         (ftype (function (fixnum t t fixnum) t) substitute-back)
         (ftype (function (fixnum t t fixnum t) t) solve-scaled)
         (ftype (function (t t fixnum) t) solve-one solve-two solve-three solve-four))

(defun measure-rows (n a scales)
  "Fill SCALES with 1/(largest entry) of each row. Nil if a row vanishes or is not finite."
  (declare (fixnum n) (type (simple-array double-float (*)) a scales))
  (with-fast-arithmetic
    (for (i n)
      (let ((row (fix (* i n))) (largest 0d0))
        (declare (fixnum row) (double-float largest))
        (for (j n)
          (setq largest (flo (max (abs (aref a (fix (+ row j)))) largest))))
        (unless (and (> largest 0d0) (< largest 1d300))
          (return-from measure-rows nil))
        (setf (aref scales i) (flo (/ 1d0 largest)))))
    t))

(defun exchange-rows (n a b offset scales first second)
  (declare (fixnum n offset first second) (type (simple-array double-float (*)) a b scales))
  (with-fast-arithmetic
    (macrolet ((exchange (array one two)
                 `(let ((kept (aref ,array ,one)))
                    (declare (double-float kept))
                    (setf (aref ,array ,one) (aref ,array ,two)
                          (aref ,array ,two) kept))))
      (for (j n)
        (exchange a (fix (+ (* first n) j)) (fix (+ (* second n) j))))
      (exchange b (fix (+ offset first)) (fix (+ offset second)))
      (exchange scales first second)
      nil)))

(defun eliminate (n a b offset scales)
  "Make A triangular, with the inverses of the pivots in its diagonal, changing B, which begins at OFFSET, alongside.
Nil if A is singular to working precision."
  (declare (fixnum n offset) (type (simple-array double-float (*)) a b scales))
  (with-fast-arithmetic
    (let ((negligible (flo (* 1d-15 (+ 0d0 n)))))
      (declare (double-float negligible))
      (for (k n)
        (let ((best k) (size 0d0) (above 0d0) (pivot-row (fix (* k n))))
          (declare (fixnum best pivot-row) (double-float size above))
          (for (i n k)
            (let ((candidate (flo (* (aref scales i) (abs (aref a (fix (+ (* i n) k))))))))
              (declare (double-float candidate))
              (when (> candidate size) (setq size candidate best i))))
          (for (i k)
            (setq above (flo (max (* (aref scales i) (abs (aref a (fix (+ (* i n) k))))) above))))
          (unless (> size (flo (* negligible above)))
            (return-from eliminate nil))
          (unless (= best k) (exchange-rows n a b offset scales k best))
          (let ((inverse (flo (/ 1d0 (aref a (fix (+ pivot-row k)))))))
            (declare (double-float inverse))
            (setf (aref a (fix (+ pivot-row k))) inverse)
            (for (i n (fix (+ k 1)))
              (let* ((row (fix (* i n)))
                     (factor (flo (* inverse (aref a (fix (+ row k)))))))
                (declare (fixnum row) (double-float factor))
                (for (j n (fix (+ k 1)))
                  (setf (aref a (fix (+ row j)))
                        (flo (- (aref a (fix (+ row j))) (* factor (aref a (fix (+ pivot-row j))))))))
                (setf (aref b (fix (+ offset i)))
                      (flo (- (aref b (fix (+ offset i))) (* factor (aref b (fix (+ offset k)))))))))))))
    t))

(defun substitute-back (n a b offset)
  (declare (fixnum n offset) (type (simple-array double-float (*)) a b))
  (with-fast-arithmetic
    (do ((i (fix (- n 1)) (fix (- i 1))))
        ((< i 0) t)
      (declare (fixnum i))
      (let ((row (fix (* i n))) (value (aref b (fix (+ offset i)))))
        (declare (fixnum row) (double-float value))
        (for (j n (fix (+ i 1)))
          (setq value (flo (- value (* (aref a (fix (+ row j))) (aref b (fix (+ offset j))))))))
        (setf (aref b (fix (+ offset i))) (flo (* value (aref a (fix (+ row i))))))))))

;;; Few equations

(eval-when (:compile-toplevel :load-toplevel :execute)
  (defun form-of-solution (n entries rights failure)
    "Code that solves N equations, written out without loops: of variables that hold the ENTRIES of the matrix by rows
and the RIGHTS, which become the solution.  FAILURE is done, and does not return, if the matrix is singular."
    (let ((units (loop repeat n collect (gensym))))
      (labels ((entry (i j) (nth (+ j (* n i)) entries))
               (right (i) (nth i rights))
               (unit (i) (nth i units))
               (largest (forms) (reduce (lambda (first second) `(flo (max ,first ,second))) forms))
               (in-units (i k) `(flo (* ,(unit i) (abs ,(entry i k)))))
               (exchange (one two) `(let ((kept ,one)) (declare (double-float kept)) (setq ,one ,two ,two kept)))
               (exchange-rows (i k)
                 `((= best ,i)
                   ,@(loop for j from k below n collect (exchange (entry k j) (entry i j)))
                   ,(exchange (right k) (right i))
                   ,(exchange (unit k) (unit i))))
               (choose-pivot (k)
                 `(let ((best ,k) (size ,(in-units k k)))
                    (declare (fixnum best) (double-float size) (ignorable best))
                    ,@(loop for i from (1+ k) below n
                            collect `(let ((candidate ,(in-units i k)))
                                       (declare (double-float candidate))
                                       (when (> candidate size) (setq size candidate best ,i))))
                    (unless (> size (flo (* ,(* 1d-15 n) ,(largest (cons 0d0 (loop for i below k
                                                                                   collect (in-units i k)))))))
                      ,failure)
                    (cond ,@(loop for i from (1+ k) below n collect (exchange-rows i k)))))
               (eliminate-below (k)
                 (loop for i from (1+ k) below n
                       collect `(let ((factor (flo (* ,(entry k k) ,(entry i k)))))
                                  (declare (double-float factor))
                                  ,@(loop for j from (1+ k) below n
                                          collect `(setq ,(entry i j) (flo (- ,(entry i j) (* factor ,(entry k j))))))
                                  (setq ,(right i) (flo (- ,(right i) (* factor ,(right k)))))))))
        `(let ,(loop for i below n
                     collect `(,(unit i) ,(largest (loop for j below n collect `(flo (abs ,(entry i j)))))))
           (declare (double-float ,@units))
           ,@(loop for unit in units
                   collect `(unless (and (> ,unit 0d0) (< ,unit 1d300)) ,failure)
                   collect `(setq ,unit (flo (/ 1d0 ,unit))))
           ,@(loop for k below n
                   collect (choose-pivot k)
                   collect `(setq ,(entry k k) (flo (/ 1d0 ,(entry k k))))
                   append (eliminate-below k))
           ,@(loop for i from (1- n) downto 0
                   collect `(setq ,(right i)
                                  (flo (* ,(reduce (lambda (value j) `(- ,value (* ,(entry i j) ,(right j))))
                                                   (loop for j from (1+ i) below n collect j)
                                                   :initial-value (right i))
                                          ,(entry i i))))))))))

(defmacro define-solution (name n)
  "A function NAME (a b offset) as SOLVE-SCALED for N equations."
  (flet ((variables (count) (loop repeat count collect (gensym))))
    (let ((entries (variables (* n n))) (rights (variables n)))
      `(defun ,name (a b offset)
         (declare (fixnum offset) (type (simple-array double-float (*)) a b))
         (with-fast-arithmetic
           (let (,@(loop for entry in entries for k from 0 collect `(,entry (aref a ,k)))
                 ,@(loop for right in rights for k from 0 collect `(,right (aref b (fix (+ offset ,k))))))
             (declare (double-float ,@entries ,@rights))
             ,(form-of-solution n entries rights `(return-from ,name nil))
             ,@(loop for right in rights for k from 0 collect `(setf (aref b (fix (+ offset ,k))) ,right))
             t))))))

(define-solution solve-one 1)
(define-solution solve-two 2)
(define-solution solve-three 3)
(define-solution solve-four 4)

(defun solve-scaled (n a b offset scales)
  "Solve A x = b, where b, and then x, stands in B from OFFSET on; A is destroyed. SCALES has N places. Nil if A is
singular to working precision."
  (declare (fixnum n offset))
  (cond ((= n 2) (solve-two a b offset))
        ((= n 3) (solve-three a b offset))
        ((= n 4) (solve-four a b offset))
        ((= n 1) (solve-one a b offset))
        (t (and (measure-rows n a scales)
                (eliminate n a b offset scales)
                (substitute-back n a b offset)))))

(defun solve-linear-in-place (n a b)
  "Replace B by the solution of A x = B; A, N x N by rows, is destroyed. Nil if it is singular."
  (solve-scaled n a b 0 (make-array n :element-type 'double-float)))
