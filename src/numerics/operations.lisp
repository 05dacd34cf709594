;;; anmech: the operations that compiled code is made of.
;;;
;;; Entry points: *DOMAINS*, OPERATION-FORM, OTHER-OF-PAIR, PAIR-FORMS, CONSTANT-VALUE, OVERFLOWING-P.

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

;;; What the library of C computes in one, as fast as one of both: C's compilers see themselves where both are wanted

(defun other-of-pair (operation)
  "What costs nothing besides OPERATION of the same operand; nil: nothing."
  (declare (ignorable operation))
  #+sbcl (and (sb-sys:find-foreign-symbol-address "sincos")
              (case operation (:sin :cos) (:cos :sin))))

(defun pair-forms (operation a pair)
  "Lisp code for OPERATION on A and, to be evaluated next, for the other one; PAIR is a variable, an array of two
doubles that lies on the stack."
  (declare (ignorable operation a pair))
  #+sbcl
  (flet ((result (place) `(the (double-float -1d0 1d0) (aref ,pair ,place))))      ; the bounds spare tests later on
    (let ((place (if (eq operation :sin) 0 1)))
      `((progn (let ((address (sb-sys:vector-sap ,pair)))
                 (sb-alien:alien-funcall
                  (sb-alien:extern-alien "sincos" (function sb-alien:void sb-alien:double sb-sys:system-area-pointer
                                                            sb-sys:system-area-pointer))
                  ,a address (sb-sys:sap+ address 8)))
               ,(result place))
        ,(result (- 1 place))))))

(defun constant-value (operation numbers)
  "OPERATION of NUMBERS, nil outside of its domain."
  (let ((domain (second (assoc operation *domains*))))
    (handler-case (eval `(let ((a ,(first numbers)) (b ,(or (second numbers) 0d0)))
                           (declare (ignorable a b))
                           (and ,(or domain t) ,(operation-form operation 'a 'b))))
      (arithmetic-error () nil))))

(defun overflowing-p (instructions &optional (start 0) (end (length instructions)))
  "Whether numbers of no great size may overflow from START to END: in 1/cosh(x) that is no harm."
  (loop for index from start below end
        thereis (member (car (aref instructions index)) '(:exp :sinh :cosh))))
