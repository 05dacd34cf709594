;;; anmech: arithmetic of doubles that no Lisp boxes.
;;;
;;; Entry points: the type DOUBLE-ARRAY, ZEROS, COPY-PART; +LEAST-UNIT+, +LEAST-SIZE+, +LARGEST-SIZE+; the macros
;;; WITH-FAST-ARITHMETIC, FLO, FIX, FOR, MAP-DOUBLES, WITH-INFINITIES and TRAPPED-AS; SPACING-AT; the condition
;;; DOMAIN-VIOLATION; on GCL, what libm has.

(in-package :anmech)
(needs "session/texts")

(deftype double-array () '(simple-array double-float (*)))

;;; Where doubles come to their ends: below 2.2d-308 they lose digits, and sums of some thousand times a number must not
;;; exceed 1.8d308.
(defconstant +least-unit+ 1d-305 "No error is measured in a smaller unit.")
(defconstant +least-size+ 2.3d-308 "Smaller numbers have fewer digits.")
(defconstant +largest-size+ 1d303 "Of a state that a motion may have.")

(defmacro with-fast-arithmetic (&body body)
  "BODY of a function on doubles, without run-time checks."
  `(locally (declare (optimize (speed 3) (safety 0) #-gcl (debug 0))) ,@body))

(defmacro flo (form)
  "FORM, of + - * / abs max min and sqrt on doubles, with every intermediate result declared: GCL boxes it otherwise."
  (if (atom form)
      form
      (destructuring-bind (operator &rest arguments) form
        (flet ((typed (&rest operands) `(the double-float (,operator ,@operands))))
          (case operator
            ((+ - * /)
             (if (null (rest arguments))
                 (if (member operator '(+ *)) `(flo ,(first arguments)) (typed `(flo ,(first arguments))))
                 (reduce #'typed (mapcar (lambda (argument) `(flo ,argument)) arguments))))
            ((max min)
             (let ((a (gensym)) (b (gensym)))
               `(let ((,a (flo ,(first arguments))) (,b (flo ,(second arguments))))
                  (declare (double-float ,a ,b))
                  (the double-float (if (,(if (eq operator 'max) '> '<) ,a ,b) ,a ,b)))))
            (abs #+gcl `(the double-float (c-abs (flo ,(first arguments))))
                 #-gcl (typed `(flo ,(first arguments))))
            (sqrt `(the double-float (sqrt (the (double-float 0d0) (flo ,(first arguments))))))
            (t `(the double-float ,form)))))))

(defmacro fix (form)
  "FORM, of + - * on fixnums, with every intermediate result declared."
  (cond ((atom form) form)
        ((and (member (first form) '(+ - *)) (cddr form))
         `(the fixnum ,(reduce (lambda (one other) `(,(first form) (the fixnum ,one) (the fixnum ,other)))
                               (mapcar (lambda (argument) `(fix ,argument)) (rest form)))))
        (t `(the fixnum ,form))))

(defmacro for ((index end &optional (start 0)) &body body)
  "BODY for INDEX from START below END, fixnums. DOTIMES and LOOP of GCL box them."
  (let ((limit (gensym)))
    `(let ((,limit ,end))
       (declare (fixnum ,limit))
       (do ((,index ,start (the fixnum (1+ ,index))))
           ((>= ,index ,limit))
         (declare (fixnum ,index))
         ,@body))))

#+gcl (defvar *zeros* (make-array 2000 :initial-element nil) "Arrays of so many zeros, to be copied.")

(defun zeros (size)
  "A new array of SIZE zeros.  GCL makes an array by a function that asks first what kind of one; to copy one takes half
the time."
  (declare (fixnum size))
  #-gcl (make-array size :element-type 'double-float :initial-element 0d0)
  #+gcl (if (< size (length (the simple-vector *zeros*)))
            (copy-seq (or (svref *zeros* size)
                          (setf (svref *zeros* size)
                                (make-array size :element-type 'double-float :initial-element 0d0))))
            (make-array size :element-type 'double-float :initial-element 0d0)))

;; told beforehand, GCL passes the arguments unboxed
(declaim (ftype (function (fixnum t fixnum t) t) copy-part))

(defun copy-part (count source start target)
  "Write COUNT numbers, which stand in SOURCE from START on, to the beginning of TARGET: REPLACE is slow on GCL."
  (declare (fixnum count start) (type (simple-array double-float (*)) source target))
  (with-fast-arithmetic
    (for (k count) (setf (aref target k) (aref source (fix (+ start k)))))
    nil))

(defmacro map-doubles (elements form)
  "A new array of what FORM, an argument of FLO, gives for the elements of double arrays of one length; ELEMENTS: lists
(name array).  MAP boxes every number, and looks up the types of arrays anew at each call."
  (let ((arrays (loop for nil in elements collect (gensym))) (new (gensym)) (place (gensym)))
    `(let ,(loop for (nil given) in elements for array in arrays collect (list array given))
       (declare (type (simple-array double-float (*)) ,@arrays))
       (let ((,new (zeros (length ,(first arrays)))))
         (declare (type (simple-array double-float (*)) ,new))
         (with-fast-arithmetic
           (for (,place (length ,new))
             (let ,(loop for (name) in elements for array in arrays collect `(,name (aref ,array ,place)))
               (declare (double-float ,@(mapcar #'first elements)))
               (setf (aref ,new ,place) (flo ,form)))))
         ,new))))

(defvar *infinities* #+gcl t #-gcl nil "Whether what overflows is infinite at present.")

(defmacro with-infinities (&body body)
  "BODY, in which what overflows is infinite, so that 1/cosh(1000) is 0: on GCL it always is.  To ask the processor for
that takes longer than ten operations, so it is asked once, however deep these are nested."
  #+gcl `(progn ,@body)
  #-gcl (let ((run (gensym)))
          `(flet ((,run () ,@body))
             (if *infinities* (,run) (let ((*infinities* t)) (allowing-infinities (,run)))))))

(defmacro trapped-as (value form)
  "FORM, or VALUE where the processor traps arithmetic in it: under GCL it never does, and to be prepared takes as long
there as a hundred operations."
  #+gcl (progn value form)
  #-gcl `(handler-case ,form (arithmetic-error () ,value)))

#-gcl
(defmacro allowing-infinities (form)
  #+sbcl `(sb-int:with-float-traps-masked (:overflow) ,form)
  #+ecl (let ((trapped (gensym)))
          `(let ((,trapped (si::trap-fpe 'last t)))
             (si::trap-fpe 'floating-point-overflow nil)
             (unwind-protect ,form (si::trap-fpe ,trapped t))))
  #-(or sbcl ecl) form)

#+gcl
(progn
  ;; GCL open-codes few of the functions of libm, and its loader resolves only those that it uses itself.
  (defmacro define-c-function (name lisp-name c-name &key (arguments 1) linked)
    (let ((parameters (subseq '(a b) 0 arguments))
          (operands (if (= arguments 1) "(#0)" "(#0,#1)")))
      `(progn
         (defun ,name ,parameters (,lisp-name ,@parameters))
         (setf (get ',name 'compiler::inline-always)
               '((,(mapcar (constantly 'long-float) parameters) long-float 8
                  ,(if linked
                       (concatenate 'string c-name operands)
                       ;; that loader does not clear static storage, so the pointer starts with a mark
                       (format nil "({static double(*f)~a=(void*)1;extern void*dlsym(void*,const char*);~
                                    if((long)f==1)f=dlsym(0,\"~a\");f~a;})"
                               (if (= arguments 1) "(double)" "(double,double)") c-name operands))))))))
  (define-c-function c-abs abs "__builtin_fabs" :linked t)
  (define-c-function c-exp exp "__builtin_exp" :linked t)
  (define-c-function c-log log "__builtin_log" :linked t)
  (define-c-function c-atan atan "__builtin_atan" :linked t)
  (define-c-function c-expt expt "pow" :arguments 2)
  (define-c-function c-atan2 atan "atan2" :arguments 2)
  (define-c-function c-asin asin "asin")
  (define-c-function c-acos acos "acos")
  (define-c-function c-sinh sinh "sinh")
  (define-c-function c-cosh cosh "cosh")
  (define-c-function c-tanh tanh "tanh")
  (define-c-function c-asinh asinh "asinh")
  (define-c-function c-acosh acosh "acosh")
  (define-c-function c-atanh atanh "atanh"))

(defun spacing-at (number)
  "How far from NUMBER the next doubles are."
  (multiple-value-bind (significand exponent) (integer-decode-float (float number 1d0))
    (declare (ignore significand))
    (if (< exponent -1000) 0d0 (expt 2d0 exponent))))

;;; Leaving the domain

(define-condition domain-violation (error)
  ((operation :initarg :operation :reader violated-operation)
   (source :initarg :source :reader violated-source))
  (:report (lambda (condition stream)
             (let ((text (and (violated-source condition) (maxima-text (violated-source condition)))))
               (case (violated-operation condition)
                 (:overflow (write-string "a value grows without bound" stream))
                 (:solve (write-string "the matrix of the equations is singular" stream))
                 (:series (format stream "~:[a function~;~:*~a~] has no power series" text))
                 (:divide (format stream "~:[a denominator~;the denominator ~:*~a~] becomes zero" text))
                 (t (format stream "~:[a root or power~;~:*~a~] has no real value" text)))))))
