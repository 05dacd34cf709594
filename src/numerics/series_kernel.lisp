;;; anmech: the coefficients of power series in doubles.
;;;
;;; A series program (series_program.lisp) works on one array: each series has +ROOM+ places one behind the other, for
;;; its coefficients from order 0 on; first the states, then the time, the instructions, the unknowns of linear
;;; equations; and behind all of them the constants, and the factors by which rates become coefficients.  A loop
;;; runs through a table of the instructions, once an order: so nothing is compiled for a model.  What an instruction
;;; does is written down once, by LATER-FORM, with variables for that loop, with numbers for straight code
;;; (series_code.lisp).
;;;
;;; The time is measured in a unit that is about as long as a step: so coefficients of high orders neither overflow
;;; nor vanish.
;;;
;;; Entry points: the structures SERIES-KERNEL and LINEAR-KERNEL; NEW-KERNEL, PLACE-CONSTANTS, UNIT-PLACED, PLACE-UNIT,
;;; EXPAND; +ROOM+; LATER-FORM, FIRST-COEFFICIENTS, RATES-TO-COEFFICIENTS.

(in-package :anmech)
(needs "arithmetic/elimination" "arithmetic/floats" "numerics/evaluation" "numerics/operations"
       "numerics/series_program")

(defconstant +room+ 25 "Coefficients of a series, of the orders 0 to 24.")

(defstruct series-kernel
  program
  (states 0 :type fixnum)
  (size 0 :type fixnum)              ; of the array
  (constants 0 :type fixnum)         ; where they begin
  (factors 0 :type fixnum)           ; of order k: the unit of time by k + 1
  (reals 0 :type fixnum)             ; of order k: k
  (inverses 0 :type fixnum)          ; and 1/k
  (unknowns 0 :type fixnum)          ; where the first one begins
  (instructions #() :type simple-vector)
  table rates                        ; see RUN-TABLE, RATES-TO-COEFFICIENTS
  (left -1 :type fixnum)             ; of series_code.lisp: how often the loop is to run before; negative: not known
  (straight #() :type simple-vector) ; for each order a list of functions; empty: there are none
  (programs '())                     ; an alist of orders and the programs in C for them (motions_in_lanes.lisp)
  linear)                            ; LINEAR-KERNEL, or nil

;;; What instructions do

(eval-when (:compile-toplevel :load-toplevel :execute)

(defun place-form (base offset)
  (if (and (integerp base) (integerp offset)) (+ base offset) `(fix (+ ,base ,offset))))

(defun coefficient-at (base offset) `(aref work ,(place-form base offset)))

(defun real-form (value) (if (rationalp value) (float value 1d0) value))

(defun sum-form (terms)
  "Their sum, in two chains that a processor adds at the same time."
  (flet ((chain (terms) (if (rest terms) `(+ ,@terms) (first terms))))
    (cond ((null terms) 0d0)
          ((null (rest terms)) (first terms))
          (t `(+ ,(chain (loop for term in terms by #'cddr collect term))
                 ,(chain (loop for term in (rest terms) by #'cddr collect term)))))))

(defun products-form (a b from to k &optional weight)
  "The sum of a[j] b[k-j], j = FROM .. TO, each times WEIGHT, a function of j and k - j that gives a form, or nil."
  (if (integerp k)
      (sum-form (loop for j from from to to
                      for factor = (and weight (funcall weight j (- k j)))
                      collect `(* ,@(and factor (list (real-form factor)))
                                  ,(coefficient-at a j) ,(coefficient-at b (- k j)))))
      (products-loop a b from to k weight)))

(defun products-loop (a b from to k weight)
  (let ((term (lambda (i l j)
                (if weight
                    `(* ,(funcall weight j `(- k-real ,j)) (aref work ,i) (aref work ,l))
                    `(* (aref work ,i) (aref work ,l))))))
    `(let ((first 0d0) (second 0d0) (i ,(place-form a from)) (l (fix (- ,(place-form b k) ,from)))
           (end ,(place-form a to))
           ,@(and weight `((j ,(float from 1d0)) (k-real (aref work (fix (+ reals ,k)))))))
       (declare (double-float first second ,@(and weight '(j k-real))) (fixnum i l end)
                ,@(and weight '((ignorable k-real))))
       (loop
         (unless (< i end) (return))
         (setq first (flo (+ first ,(funcall term 'i 'l 'j))))
         (setq second (flo (+ second ,(funcall term '(fix (+ i 1)) '(fix (- l 1)) '(+ j 1d0)))))
         (setq i (fix (+ i 2)) l (fix (- l 2))
               ,@(and weight '(j (flo (+ j 2d0))))))
       (when (= i end) (setq first (flo (+ first ,(funcall term 'i 'l 'j)))))
       (flo (+ first second)))))

(defun square-form (a from k)
  "The sum of a[j] a[k-j], j = FROM .. k - FROM."
  (if (integerp k)
      (let ((half (sum-form (loop for j from from below (/ k 2)
                                  collect `(* ,(coefficient-at a j) ,(coefficient-at a (- k j))))))
            (middle (and (evenp k) `(* ,(coefficient-at a (/ k 2)) ,(coefficient-at a (/ k 2))))))
        (cond ((eql half 0d0) (or middle 0d0))
              (middle `(+ (* 2d0 ,half) ,middle))
              (t `(* 2d0 ,half))))
      `(let ((twice (flo (* 2d0 ,(products-loop a a from '(fix (ash (fix (- k 1)) -1)) k nil))))
             (middle ,(coefficient-at a '(fix (ash k -1)))))
         (declare (double-float twice middle))
         (if (logtest 1 ,k) twice (flo (+ twice (* middle middle)))))))

(defun below-form (k) (if (integerp k) (1- k) `(fix (- ,k 1))))

(defun real-of-order (k) (if (integerp k) (float k 1d0) `(aref work (fix (+ reals ,k)))))
(defun inverse-of-order (k) (if (integerp k) (/ 1d0 k) `(aref work (fix (+ inverses ,k)))))

(defun first-order-form (j l) (declare (ignore l)) j)

(defun power-weight (c)
  (lambda (l j)                                ; of a[l] y[j]
    (if (and (rationalp c) (rationalp l))
        (- (* c l) j)
        `(- (* ,(real-form c) ,(real-form l)) ,(real-form j)))))

(defun later-form (operation k y a b c sign)
  "The coefficient of order K > 0; C is a constant's value, or a third series."
  (let ((below (below-form k)))
    (flet ((at (series) (coefficient-at series k))
           (first-at (series) (coefficient-at series 0))
           (signed (form) (if (eql sign -1) `(- ,form) form)))
      (ecase operation
        (:add `(+ ,(at a) ,(at b)))
        (:subtract `(- ,(at a) ,(at b)))
        (:negate `(- ,(at a)))
        (:shift (at a))
        (:scale `(* ,(real-form c) ,(at a)))
        (:over `(/ ,(at a) ,(real-form c)))
        ((:fixed :sign :floor) 0d0)
        (:absolute `(* (if (< ,(first-at a) 0d0) -1d0 1d0) ,(at a)))
        (:larger `(if (> ,(first-at a) ,(first-at b)) ,(at a) ,(at b)))
        (:smaller `(if (> ,(first-at a) ,(first-at b)) ,(at b) ,(at a)))
        (:multiply (products-form a b 0 k k))
        (:square (square-form a 0 k))
        (:divide `(/ (- ,(at a) ,(products-form b y 1 k k)) ,(first-at b)))
        (:reciprocal `(/ (- ,(products-form a y 1 k k)) ,(first-at a)))
        (:sqrt `(/ (- ,(at a) ,(square-form y 1 k)) (* 2d0 ,(first-at y))))
        (:power `(/ (* ,(products-form a y 1 k k (power-weight c)) ,(inverse-of-order k)) ,(first-at a)))
        (:primitive (signed `(* ,(products-form a b 1 k k #'first-order-form) ,(inverse-of-order k))))
        (:primitive-over `(/ (- ,(signed (at a))
                                (* ,(products-form y b 1 below k #'first-order-form) ,(inverse-of-order k)))
                             ,(first-at b)))
        (:angle `(/ (* (- ,(products-form a b 1 k k #'first-order-form) ,(products-form b a 1 k k #'first-order-form)
                          ,(products-form y c 1 below k #'first-order-form))
                       ,(inverse-of-order k))
                    ,(first-at c)))))))

(defun first-form (operation a b c)
  "The coefficient of order 0, where that is no function's."
  (flet ((at (series) (coefficient-at series 0)))
    (ecase operation
      (:add `(+ ,(at a) ,(at b)))
      (:subtract `(- ,(at a) ,(at b)))
      (:negate `(- ,(at a)))
      (:shift `(+ ,(at a) ,(real-form c)))
      (:scale `(* ,(real-form c) ,(at a)))
      (:over `(/ ,(at a) ,(real-form c)))
      (:fixed (real-form c))
      (:multiply `(* ,(at a) ,(at b)))
      (:square `(* ,(at a) ,(at a)))
      (:divide `(/ ,(at a) ,(at b)))
      (:reciprocal `(/ ,(real-form c) ,(at a)))
      (:sqrt `(sqrt ,(at a)))
      (:absolute `(abs ,(at a)))
      (:sign `(cond ((> ,(at a) 0d0) 1d0) ((< ,(at a) 0d0) -1d0) (t 0d0)))
      (:floor (operation-form :floor (at a) nil))
      (:larger `(if (> ,(at a) ,(at b)) ,(at a) ,(at b)))
      (:smaller `(if (> ,(at a) ,(at b)) ,(at b) ,(at a))))))

(defparameter *loop-operations*
  '((:multiply) (:add) (:subtract) (:scale) (:square) (:power) (:negate) (:shift) (:divide) (:reciprocal) (:sqrt)
    (:primitive 1) (:primitive -1) (:primitive-over 1) (:primitive-over -1) (:angle) (:over) (:fixed) (:absolute)
    (:sign) (:floor) (:larger) (:smaller))
  "In the order of their codes in the table; with the sign of those that have one."))

;;; The loop through a table: for each instruction its code, its place, those of up to three operands

(declaim (ftype (function (t t fixnum fixnum fixnum) t) run-table)
         (ftype (function (t t fixnum fixnum) t) rates-to-coefficients))

(defmacro table-cases ()
  `(case code
     ,@(loop for (operation sign) in *loop-operations*
             for code from 0
             collect `(,code (setf (aref work (fix (+ y k)))
                                   (flo ,(later-form operation 'k 'y 'a 'b
                                                     (if (member operation '(:angle)) 'c '(aref work c)) sign)))))))

(defun run-table (table work k reals inverses)
  "The coefficients of order K > 0 of all instructions."
  (declare (type (simple-array fixnum (*)) table) (type (simple-array double-float (*)) work)
           (fixnum k reals inverses))
  (with-fast-arithmetic
    (let ((position 0) (end (length table)))
      (declare (fixnum position end))
      (loop
        (unless (< position end) (return nil))
        (let ((code (aref table position)) (y (aref table (fix (+ position 1)))) (a (aref table (fix (+ position 2))))
              (b (aref table (fix (+ position 3)))) (c (aref table (fix (+ position 4)))))
          (declare (fixnum code y a b c))
          (table-cases)
          (setq position (fix (+ position 5))))))))

(defun rates-to-coefficients (table work k factors)
  "The coefficients of order K + 1 of the states."
  (declare (type (simple-array fixnum (*)) table) (type (simple-array double-float (*)) work) (fixnum k factors))
  (with-fast-arithmetic
    (let ((factor (aref work (fix (+ factors k)))) (position 0) (end (length table)))
      (declare (double-float factor) (fixnum position end))
      (loop
        (unless (< position end) (return nil))
        (let ((x (aref table position)) (rate (aref table (fix (+ position 1)))))
          (declare (fixnum x rate))
          (setf (aref work (fix (+ x k 1)))
                (cond ((>= rate 0) (flo (* factor (aref work (fix (+ rate k))))))
                      ((= k 0) (flo (* factor (aref work (fix (- -1 rate))))))
                      (t 0d0)))
          (setq position (fix (+ position 2))))))))

;;; Order 0

(declaim (ftype (function (t t) t) first-coefficients)
         (ftype (function (t t fixnum) t) first-coefficient))

(defmacro first-cases (otherwise)
  "The value of order 0 of what takes no function, where it is defined; else OTHERWISE."
  `(case code
     ,@(loop for (operation) in *loop-operations*
             for code from 0
             for form = (and (member operation '(:add :subtract :negate :shift :scale :fixed :multiply :square :divide
                                                 :reciprocal :sqrt :absolute :larger :smaller))
                             `(setf (aref work y) (flo ,(first-form operation 'a 'b '(aref work c)))))
             for denominator = (case operation (:divide 'b) (:reciprocal 'a))
             when form collect (list code (cond (denominator `(if (= 0d0 (aref work ,denominator)) ,otherwise ,form))
                                                ((eq operation :sqrt) `(if (> (aref work a) 0d0) ,form ,otherwise))
                                                (t form)))
             when (eq operation :power)
               collect `(,code (let ((base (aref work a)))
                                 (declare (double-float base))
                                 (if (and (= -1.5d0 (aref work c)) (> base 0d0))
                                     (setf (aref work y) (flo (/ 1d0 (* base (sqrt base)))))
                                     ,otherwise))))
     (t ,otherwise)))

(defun first-coefficients (kernel work)
  "The values of all instructions; nil where there is no power series."
  (declare (type (simple-array double-float (*)) work))
  (let ((table (series-kernel-table kernel)))
    (declare (type (simple-array fixnum (*)) table))
    (with-fast-arithmetic
      (let ((position 0) (end (length table)) (index 0))
        (declare (fixnum position end index))
        (loop
          (unless (< position end) (return t))
          (let ((code (aref table position)) (y (aref table (fix (+ position 1))))
                (a (aref table (fix (+ position 2)))) (b (aref table (fix (+ position 3))))
                (c (aref table (fix (+ position 4)))))
            (declare (fixnum code y a b c))
            (first-cases (unless (first-coefficient kernel work index) (return nil)))
            (setq position (fix (+ position 5)) index (fix (+ index 1)))))))))

(defun first-coefficient (kernel work index)
  "The value of the instruction INDEX; nil where there is no power series."
  (declare (type (simple-array double-float (*)) work) (fixnum index))
  (let ((constants (series-kernel-constants kernel)) (y (* +room+ (+ 1 index (series-kernel-states kernel)))))
    (declare (fixnum constants y))
    (flet ((value (number) (aref work (the fixnum (* +room+ (the fixnum number)))))
           (constant (number) (aref work (the fixnum (+ constants (the fixnum number)))))
           (regular-p (x) (/= (the double-float x) 0d0)))
      (destructuring-bind (operation a &optional b c d) (svref (series-kernel-instructions kernel) index)
        (declare (ignore d))
        (let ((found (ecase operation
                       (:over (double-operation :divide (value a) (constant b)))
                       (:divide (double-operation :divide (value a) (value b)))
                       (:reciprocal (double-operation :divide (constant b) (value a)))
                       (:sqrt (and (regular-p (value a)) (double-operation :sqrt (value a))))
                       (:power (and (regular-p (value a)) (double-operation :expt (value a) (constant b))))
                       (:primitive (case a                       ; as these are many
                                     (:sin (sin (value b)))
                                     (:cos (cos (value b)))
                                     (t (double-operation a (value b)))))
                       (:primitive-over (and (regular-p (value c)) (double-operation a (value b))))
                       (:angle (and (regular-p (value c)) (double-operation :atan2 (value a) (value b))))
                       (:sign (double-operation :signum (value a)))
                       (:floor (double-operation :floor (value a))))))
          (and found (progn (setf (aref work y) found) t)))))))

;;; Linear equations

(defmacro products-of-series (a b k)
  "The sum of a[j] b[k-j], j = 1 .. k; all are variables."
  (products-form a b 1 k k))

(defstruct linear-kernel
  (size 0 :type fixnum)
  (entries nil :type (simple-array fixnum (*)))     ; of each: row, column, place in the array, whether it is constant
  (rights nil :type (simple-array fixnum (*)))      ; of each: its place, whether it is constant
  (unknowns 0 :type fixnum)
  (matrix nil :type double-array)                   ; factors of the matrix of order 0
  (scales nil :type double-array)
  (order nil :type (simple-array fixnum (*)))       ; of the rows
  (right nil :type double-array))

(defun factor-first (linear work factors)
  "Factor the matrix of order 0; nil where it is singular.  FACTORS change each entry a little, or are nil."
  (declare (type (simple-array double-float (*)) work))
  (let* ((size (linear-kernel-size linear)) (matrix (linear-kernel-matrix linear))
         (scales (linear-kernel-scales linear)) (order (linear-kernel-order linear))
         (entries (linear-kernel-entries linear)))
    (declare (type (simple-array double-float (*)) matrix scales) (type (simple-array fixnum (*)) order entries)
             (fixnum size))
    (with-fast-arithmetic
      (for (k (fix (* size size))) (setf (aref matrix k) 0d0))
      (for (i size) (setf (aref order i) i (aref scales i) 0d0))
      (let ((position 0) (end (length entries)) (number 0))
        (declare (fixnum position end number))
        (loop
          (unless (< position end) (return))
          (let* ((i (aref entries position)) (j (aref entries (fix (+ position 1))))
                 (value (aref work (aref entries (fix (+ position 2))))))
            (declare (fixnum i j) (double-float value))
            (when factors
              (setq value (flo (* value (aref (the (simple-array double-float (*)) factors) number)))))
            (setf (aref matrix (fix (+ (* i size) j))) value)
            (setf (aref scales i) (flo (max (aref scales i) (abs value)))))
          (setq position (fix (+ position 4)) number (fix (+ number 1)))))
      (for (i size)
        (unless (and (> (aref scales i) 0d0) (< (aref scales i) 1d300)) (return-from factor-first nil)))
      (for (k size)
        (let ((best k) (largest 0d0))
          (declare (fixnum best) (double-float largest))
          (for (i size k)
            (let* ((row (aref order i))
                   (share (flo (/ (abs (aref matrix (fix (+ (* row size) k)))) (aref scales row)))))
              (declare (fixnum row) (double-float share))
              (when (> share largest) (setq largest share best i))))
          (unless (> largest (flo (* 1d-15 (+ 0d0 size)))) (return-from factor-first nil))
          (let* ((pivot-row (aref order best)) (pivot 0d0))
            (declare (fixnum pivot-row) (double-float pivot))
            (setf (aref order best) (aref order k) (aref order k) pivot-row)
            (setq pivot (aref matrix (fix (+ (* pivot-row size) k))))
            (for (i size (fix (+ k 1)))
              (let* ((row (the fixnum (* size (aref order i))))
                     (part (flo (/ (aref matrix (fix (+ row k))) pivot))))
                (declare (fixnum row) (double-float part))
                (setf (aref matrix (fix (+ row k))) part)
                (for (j size (fix (+ k 1)))
                  (setf (aref matrix (fix (+ row j)))
                        (flo (- (aref matrix (fix (+ row j)))
                                (* part (aref matrix (fix (+ (* size pivot-row) j)))))))))))))
      t)))

(defun unknowns-of-order (linear work k factors)
  "The coefficients of order K of the unknowns."
  (declare (type (simple-array double-float (*)) work) (fixnum k))
  (let* ((size (linear-kernel-size linear)) (matrix (linear-kernel-matrix linear)) (right (linear-kernel-right linear))
         (order (linear-kernel-order linear)) (entries (linear-kernel-entries linear))
         (rights (linear-kernel-rights linear)) (unknowns (linear-kernel-unknowns linear)))
    (declare (type (simple-array double-float (*)) matrix right) (type (simple-array fixnum (*)) order entries rights)
             (fixnum size unknowns))
    (with-fast-arithmetic
      (for (i size)
        (let ((place (aref rights (fix (* 2 i)))))
          (declare (fixnum place))
          (setf (aref right i) (cond ((= 0 (aref rights (fix (+ (* 2 i) 1)))) (aref work (fix (+ place k))))
                                     ((= k 0) (aref work place))
                                     (t 0d0)))))
      (let ((position 0) (end (length entries)) (number 0))
        (declare (fixnum position end number))
        (loop
          (unless (< position end) (return))
          (when (= 0 (aref entries (fix (+ position 3))))
            (let* ((i (aref entries position)) (a (aref entries (fix (+ position 2))))
                   (column (aref entries (fix (+ position 1)))) (u (fix (+ unknowns (* +room+ column))))
                   (sum (products-of-series a u k)))
              (declare (fixnum i a u column) (double-float sum))
              (when factors
                (setq sum (flo (* sum (aref (the (simple-array double-float (*)) factors) number)))))
              (setf (aref right i) (flo (- (aref right i) sum)))))
          (setq position (fix (+ position 4)) number (fix (+ number 1)))))
      (for (i size)
        (let* ((row (aref order i)) (sum (aref right row)) (start (fix (* size row))))
          (declare (fixnum row start) (double-float sum))
          (for (j i) (setq sum (flo (- sum (* (aref matrix (fix (+ start j))) (aref right (aref order j)))))))
          (setf (aref right row) sum)))
      (do ((i (fix (- size 1)) (fix (- i 1))))
          ((< i 0) nil)
        (declare (fixnum i))
        (let* ((row (aref order i)) (start (fix (* size row))) (sum (aref right row)))
          (declare (fixnum row start) (double-float sum))
          (for (j size (fix (+ i 1)))
            (setq sum (flo (- sum (* (aref matrix (fix (+ start j))) (aref work (fix (+ unknowns (* +room+ j) k))))))))
          (setf (aref work (fix (+ unknowns (* +room+ i) k))) (flo (/ sum (aref matrix (fix (+ start i)))))))))))

;;; Kernels

(defun new-kernel (series)
  "For the series program SERIES."
  (let* ((n (series-program-states series)) (instructions (coerce (series-program-instructions series) 'simple-vector))
         (linear (series-program-linear series)) (count (length instructions))
         (unknowns (* +room+ (+ n 1 count)))
         (constants (+ unknowns (if linear (* +room+ (linear-series-size linear)) 0)))
         (kernel (make-series-kernel :program series :states n :instructions instructions :unknowns unknowns
                              :constants constants))
         (end (+ constants (length (series-program-constants series)))))
    (setf (series-kernel-factors kernel) end
          (series-kernel-reals kernel) (+ end +room+)
          (series-kernel-inverses kernel) (+ end (* 2 +room+))
          (series-kernel-size kernel) (+ end (* 3 +room+))
          (series-kernel-linear kernel) (and linear (new-linear-kernel kernel linear))
          (series-kernel-table kernel) (table-of kernel)
          (series-kernel-rates kernel) (places (loop for rate in (series-program-rates series)
                                              for i from 0
                                              append (list (* +room+ i)
                                                           (if (eq :constant (and (consp rate) (car rate)))
                                                               (- -1 (place-of-series kernel rate))
                                                               (place-of-series kernel rate))))))
    kernel))

(defun place-of-series (kernel operand)
  (cond ((integerp operand) (* +room+ operand))
        ((eq :unknown (car operand)) (+ (series-kernel-unknowns kernel) (* +room+ (cdr operand))))
        (t (+ (series-kernel-constants kernel) (cdr operand)))))

(defun table-of (kernel)
  (let ((constants (series-kernel-constants kernel)))
    (flet ((at (series) (* +room+ series))
           (code (operation sign)
             (position (if sign (list operation sign) (list operation)) *loop-operations* :test #'equal)))
      (places
       (loop for (operation a b c d) across (series-kernel-instructions kernel)
             for y from (at (1+ (series-kernel-states kernel))) by +room+
             append (ecase operation
                      ((:add :subtract :multiply :divide :larger :smaller)
                       (list (code operation nil) y (at a) (at b) 0))
                      ((:negate :square :sqrt :absolute :sign :floor) (list (code operation nil) y (at a) 0 0))
                      ((:shift :scale :over :power :reciprocal)
                       (list (code operation nil) y (at a) 0 (+ constants b)))
                      (:fixed (list (code operation nil) y 0 0 (+ constants a)))
                      ((:primitive :primitive-over) (list (code operation d) y (at b) (at c) 0))
                      (:angle (list (code operation nil) y (at a) (at b) (at c)))))))))

(defun new-linear-kernel (kernel linear)
  (let ((size (linear-series-size linear)))
    (flet ((constant-p (operand) (if (consp operand) 1 0))
           (doubles-for (number) (make-array number :element-type 'double-float :initial-element 0d0)))
      (make-linear-kernel :size size :unknowns (series-kernel-unknowns kernel)
                          :entries (places (loop for (i j operand) in (linear-series-entries linear)
                                                 append (list i j (place-of-series kernel operand)
                                                              (constant-p operand))))
                          :rights (places (loop for operand in (linear-series-rights linear)
                                                append (list (place-of-series kernel operand) (constant-p operand))))
                          :matrix (doubles-for (* size size)) :scales (doubles-for size) :right (doubles-for size)
                          :order (make-array size :element-type 'fixnum :initial-element 0)))))

(defun place-constants (kernel in &rest arrays)
  "Compute the constants of ARRAYS from IN, which is like the input of the field."
  (let ((values (constant-values (series-kernel-program kernel) *doubles* in)))
    (declare (simple-vector values))
    (dolist (array arrays)
      (let ((work array) (place (series-kernel-constants kernel)) (reals (series-kernel-reals kernel))
            (inverses (series-kernel-inverses kernel)))
        (declare (type (simple-array double-float (*)) work) (fixnum place reals inverses))
        (with-fast-arithmetic
          (for (i (length values)) (setf (aref work (fix (+ place i))) (the double-float (svref values i))))
          (for (k +room+)
            (let ((real (flo (+ 0d0 k))))
              (declare (double-float real))
              (setf (aref work (fix (+ reals k))) real
                    (aref work (fix (+ inverses k))) (if (= k 0) 0d0 (flo (/ 1d0 real)))))))))))

(defmacro unit-placed (kernel work)
  "The unit of time; it stands where the first coefficient of the time is."
  `(aref ,work (fix (+ 1 (* +room+ (series-kernel-states ,kernel))))))

(defun place-unit (kernel work unit)
  "Let UNIT be that of time."
  (declare (type (simple-array double-float (*)) work) (double-float unit))
  (let ((factors (series-kernel-factors kernel)))
    (declare (fixnum factors))
    (with-fast-arithmetic
      (setf (unit-placed kernel work) unit)
      (for (k +room+) (setf (aref work (fix (+ factors k))) (flo (/ unit (+ 1d0 k)))))
      nil)))

(defun expand (kernel work order factors)
  "The coefficients up to ORDER of the states, whose values, and that of the time, stand in WORK; nil where there is no
power series.  FACTORS change the entries of linear equations a little, or are nil."
  (declare (fixnum order) (type double-array work))
  (let ((linear (series-kernel-linear kernel)) (table (series-kernel-table kernel)) (rates (series-kernel-rates kernel))
        (reals (series-kernel-reals kernel)) (inverses (series-kernel-inverses kernel))
        (scale (series-kernel-factors kernel)))
    (when (and (first-coefficients kernel work)
               (or (null linear) (factor-first linear work factors)))
      (for (k order)
        (when (> k 0) (run-table table work k reals inverses))
        (when linear (unknowns-of-order linear work k factors))
        (rates-to-coefficients rates work k scale))
      t)))
