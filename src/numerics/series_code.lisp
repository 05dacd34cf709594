;;; anmech: straight code for the coefficients of power series.
;;;
;;; The loop of series_kernel.lisp spends more time on what surrounds short sums than on the sums.  For a small program
;;; that runs long enough the sums of every order are written out, and compiled: the numbers that come out are the same
;;; to the last bit, since they are added in the same order.  That takes some tenths of a second, at most some seconds,
;;; so it is done when the loop has taken about as long as that would save.
;;;
;;; Entry points: EXPAND-SERIES, STRAIGHT-CODE-FOR.

(in-package :anmech)
(needs "arithmetic/floats" "numerics/codegen" "numerics/dag" "numerics/series_kernel" "numerics/series_program")

(defparameter *long-enough* #+sbcl 40000 #-sbcl 10000
  "So many times for each sum of products the loop runs before straight code is made.")
(defparameter *least-sums* 5 "Compiling takes as long as for so many at least.")
(defparameter *most-sums* 16
  "Programs with more sums of products have no straight code: the sums prevail, and to compile them takes long.")
(defparameter *most-straight* 80 "Nor have those with more instructions.")

(defmacro run-functions (functions work order)
  `(dolist (function ,functions) (funcall (the function function) ,work ,order)))

(defun expand-series (kernel work order factors)
  "As EXPAND, by straight code where there is some."
  (declare (fixnum order) (type double-array work))
  (let ((straight (series-kernel-straight kernel)))
    (declare (simple-vector straight))
    (cond ((> order (length straight))
           (count-run kernel order)
           (expand kernel work order factors))
          ((series-kernel-linear kernel) (expand-with-equations kernel straight work order factors))
          ((first-coefficients kernel work)
           (rates-to-coefficients (series-kernel-rates kernel) work 0 (series-kernel-factors kernel))
           (with-fast-arithmetic
             (for (k order 1) (run-functions (svref straight k) work order))
             t)))))

(defun expand-with-equations (kernel straight work order factors)
  "As EXPAND; STRAIGHT code computes what the equations of an order and the rates are made of."
  (declare (simple-vector straight) (fixnum order) (type double-array work))
  (let ((linear (series-kernel-linear kernel)) (rates (series-kernel-rates kernel))
        (scale (series-kernel-factors kernel)))
    (when (and (first-coefficients kernel work) (factor-first linear work factors))
      (for (k order)
        (when (> k 0) (run-functions (svref straight k) work order))
        (unknowns-of-order linear work k factors)
        (rates-to-coefficients rates work k scale))
      t)))

(defun count-run (kernel order)
  "Make straight code, also for this ORDER, if the loop has run for long enough."
  (let ((left (series-kernel-left kernel)))
    (declare (fixnum left))
    (when (minusp left) (setq left (runs-without-code kernel)))
    (setf (series-kernel-left kernel) (fix (- left 1)))
    (when (= left 0) (straight-code-for kernel (max order 14)))))

(defun runs-without-code (kernel)
  (if (small-p kernel)
      (* *long-enough* (max *least-sums* (sums-of-products (series-kernel-program kernel))))
      most-positive-fixnum))

(defun small-p (kernel)
  (and (<= (length (series-kernel-instructions kernel)) *most-straight*)
       (<= (sums-of-products (series-kernel-program kernel)) *most-sums*)))

(defun straight-code-for (kernel order)
  "Make functions of the array for the coefficients up to ORDER, those of some orders in one, if they are not too many."
  (let ((code (make-array order :initial-element '()))
        (together (if (or (series-kernel-linear kernel) (> (length (straight-forms kernel 1)) *straight-part*))
                      1
                      *orders-together*)))
    (loop for first from 1 below order by together
          for orders = (loop for k from first below (min order (+ first together))
                             collect (cons k (straight-forms kernel k)))
          do (setf (svref code first)
                   (compiled-blocks (if (= together 1)
                                        (loop for part in (in-parts (rest (first orders)))
                                              collect (straight-block (list (cons first part))))
                                        (list (straight-block orders)))
                                    (zeros-of-code) '())))
    (setf (series-kernel-straight kernel) code)))

(defun zeros-of-code () (make-array 0 :element-type 'double-float))

(defparameter *straight-part* #+sbcl 20 #-sbcl 40
  "So many numbers of an order one function computes, at most: SBCL makes code of a larger one that takes as long as the
loop.")
(defparameter *orders-together* #+sbcl 1 #-sbcl 8 "For so many orders, where calls and compilations take long.")

(defun in-parts (forms)
  "FORMS in parts of nearly the same length."
  (let* ((parts (ceiling (length forms) *straight-part*)) (length (ceiling (length forms) parts)))
    (loop while forms
          collect (loop repeat length while forms collect (pop forms)))))

(defun straight-forms (kernel k)
  "Pairs of a place and the form of the number there: of the coefficients of order K, and of the states of the next, if
there are no equations to be solved before."
  (let ((constants (series-kernel-constants kernel)) (factor `(aref work ,(+ k (series-kernel-factors kernel)))))
    (flet ((at (series) (* +room+ series)))
      (append
       (loop for (operation a b c d) across (series-kernel-instructions kernel)
             for y from (at (1+ (series-kernel-states kernel))) by +room+
             collect (cons (+ y k)
                           (ecase operation
                             ((:add :subtract :multiply :divide :larger :smaller)
                              (later-form operation k y (at a) (at b) nil nil))
                             ((:negate :square :sqrt :absolute :sign :floor :fixed)
                              (later-form operation k y (at a) nil nil nil))
                             ((:shift :scale :over :power :reciprocal)
                              (later-form operation k y (at a) nil (constant-form kernel b constants) nil))
                             ((:primitive :primitive-over) (later-form operation k y (at b) (at c) nil d))
                             (:angle (later-form operation k y (at a) (at b) (at c) nil)))))
       (loop with rates = (if (series-kernel-linear kernel) #() (series-kernel-rates kernel))
             for i from 0 below (length rates) by 2
             collect (cons (+ (aref rates i) k 1)
                           (if (minusp (aref rates (1+ i)))
                               0d0
                               `(* ,factor (aref work ,(+ k (aref rates (1+ i))))))))))))

(defun constant-form (kernel number constants)
  "The constant of this NUMBER: a double, or where it stands."
  (destructuring-bind (head . value) (aref (series-program-constants (series-kernel-program kernel)) number)
    (if (eq head :number) (to-double value) `(aref work ,(+ constants number)))))

(defun straight-block (orders)
  "A lambda expression of the array and the order, below which it computes ORDERS, lists of one and of pairs of places
and forms."
  `(lambda (work order)
     (declare (type (simple-array double-float (*)) work) (fixnum order) (ignorable order) ,*fast-code*)
     ,@(loop for (k . pairs) in orders collect `(when (< ,k order) ,(straight-form pairs)))
     nil))

(defun straight-form (pairs)
  "What computes PAIRS; of these nothing is read from the array again."
  (let* ((names (loop for (place) in pairs collect (cons `(aref work ,place) (make-symbol (format nil "X~d" place)))))
         (variables (mapcar #'cdr names)))
    `(let* ,(loop for (nil . form) in pairs
                  for variable in variables
                  collect `(,variable (flo ,(sublis names form :test #'equal))))
       (declare (double-float ,@variables))
       ,@(loop for (place) in pairs
               for variable in variables
               collect `(setf (aref work ,place) ,variable)))))
