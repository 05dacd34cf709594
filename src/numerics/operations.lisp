;;; anmech: the operations that compiled code is made of.
;;;
;;; Entry points: *DOMAINS*, OPERATION-FORM, CONSTANT-VALUE.

(in-package :anmech)

(defparameter *domains*
  ;; the condition on the operands a and b under which an operation has a real value
  '((:divide (/= b 0d0)) (:sqrt (>= a 0d0)) (:log (> a 0d0)) (:expt (or (> a 0d0) (and (= a 0d0) (> b 0d0))))
    (:asin (<= -1d0 a 1d0)) (:acos (<= -1d0 a 1d0)) (:acosh (>= a 1d0)) (:atanh (< -1d0 a 1d0))))

(defun operation-form (operation a b)
  "Lisp code for OPERATION on the variables or numbers A and B, which are in its domain."
  (flet ((real (lisp c &rest arguments)
           (declare (ignorable lisp c))
           `(the double-float (#-gcl ,lisp #+gcl ,c ,@arguments))))
    (ecase operation
      (:add `(the double-float (+ ,a ,b)))
      (:subtract `(the double-float (- ,a ,b)))
      (:multiply `(the double-float (* ,a ,b)))
      (:divide `(the double-float (/ ,a ,b)))
      (:negate `(the double-float (- ,a)))
      (:sqrt `(the double-float (sqrt (the (double-float 0d0) ,a))))
      (:sin `(the double-float (sin ,a)))
      (:cos `(the double-float (cos ,a)))
      (:tan `(the double-float (tan ,a)))
      (:exp (real 'exp 'c-exp a))
      (:log (real 'log 'c-log `(the (double-float (0d0)) ,a)))
      (:expt (real 'expt 'c-expt `(the (double-float 0d0) ,a) b))
      (:asin (real 'asin 'c-asin `(the (double-float -1d0 1d0) ,a)))
      (:acos (real 'acos 'c-acos `(the (double-float -1d0 1d0) ,a)))
      (:atan (real 'atan 'c-atan a))
      (:atan2 (real 'atan 'c-atan2 a b))
      (:sinh (real 'sinh 'c-sinh a))
      (:cosh (real 'cosh 'c-cosh a))
      (:tanh (real 'tanh 'c-tanh a))
      (:asinh (real 'asinh 'c-asinh a))
      (:acosh (real 'acosh 'c-acosh `(the (double-float 1d0) ,a)))
      (:atanh (real 'atanh 'c-atanh `(the (double-float (-1d0) (1d0)) ,a)))
      (:erf `(the double-float (slatec::derf ,a)))
      (:erfc `(the double-float (if (< ,a 26.5d0) (slatec::derfc ,a) 0d0)))     ; it complains of larger ones
      (:abs (real 'abs 'c-abs a))
      (:signum `(the double-float (cond ((> ,a 0d0) 1d0) ((< ,a 0d0) -1d0) (t 0d0))))
      (:floor `(the double-float (if (< (abs ,a) 1d15) (ffloor ,a) ,a)))     ; larger ones are whole
      (:max `(the double-float (if (> ,a ,b) ,a ,b)))
      (:min `(the double-float (if (< ,a ,b) ,a ,b))))))

(defun constant-value (operation numbers)
  "OPERATION of NUMBERS, nil outside of its domain."
  (let ((domain (second (assoc operation *domains*))))
    (handler-case (eval `(let ((a ,(first numbers)) (b ,(or (second numbers) 0d0)))
                           (declare (ignorable a b))
                           (and ,(or domain t) ,(operation-form operation 'a 'b))))
      (arithmetic-error () nil))))
