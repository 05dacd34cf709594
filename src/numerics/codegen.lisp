;;; anmech: straight-line programs as compiled functions of double arrays.
;;;
;;; Entry points: COMPILE-EXPRESSIONS, COMPILED-BEFORE, COMPILED-PROGRAM, ONE-BLOCK-P, EXPRESSIONS-PROGRAM,
;;; OPERATION-COUNT, LEAVE-DOMAIN; for code of other forms, *FAST-CODE*, GUARDED-FORM, NUMBER-OF-OPERAND,
;;; QUIETLY-COMPILED.
;;;
;;; The code is cut into blocks of a hundred instructions, each a function of its own: compilers need more than linear
;;; time for long bodies. What one block hands to a later one goes through an array. The three Lisps open-code
;;; different functions; OPERATION-FORM knows which.

(in-package :anmech)
(needs "arithmetic/floats" "numerics/dag" "numerics/operations" "numerics/sharing")

(defparameter *fast-code* '(optimize (speed 3) (safety 0) #-gcl (debug 0)))

;;; Leaving the domain

(defun leave-domain (guards index)
  "Called by generated code whose operand is outside of the domain of instruction INDEX."
  (destructuring-bind (operation . source) (cdr (assoc index guards))
    (error 'domain-violation :operation operation :source source)))

;;; Operations

(defun number-of-operand (operand)
  "The double that a number or constant stands for."
  (to-double (if (eq :constant (car operand)) (cdr (assoc (cdr operand) *constants*)) (cdr operand))))

(defun guarded-form (operation a b index)
  (let ((form (operation-form operation a b))
        (domain (second (assoc operation *domains*))))
    (cond ((null domain) form)
          ;; a constant denominator needs no guard
          ((and (eq operation :divide) (numberp b)) form)
          (t `(if ,(sublis (list (cons 'a a) (cons 'b b)) domain)
                  ,form
                  (the double-float (leave-domain guards ,index)))))))

;;; Blocks

(defparameter *block-size* 100)

(defun block-forms (program finish)
  "Lambda expressions of two arrays, in and out, to be called one after the other; WORK and GUARDS are free in them.
The second value is the number of places that they use in WORK."
  (let* ((instructions (program-instructions program))
         (count (length instructions))
         (block-of (lambda (index) (floor index *block-size*)))
         (places (places-between-blocks program block-of))
         (blocks '()))
    (do ((start 0 (+ start *block-size*)))
        ((>= start (max count 1)))
      (push (block-form program start (min count (+ start *block-size*)) places finish) blocks))
    (values (nreverse blocks) (count-if-not #'null places))))

(defun places-between-blocks (program block-of)
  "For each instruction its place in the work array, nil if only its own block uses it."
  (let* ((instructions (program-instructions program))
         (places (make-array (length instructions) :initial-element nil))
         (next 0))
    (dotimes (index (length instructions) places)
      (dolist (operand (rest (aref instructions index)))
        (when (and (integerp operand)
                   (null (aref places operand))
                   (/= (funcall block-of operand) (funcall block-of index)))
          (setf (aref places operand) next)
          (incf next))))))

(defun partner-below (end index instructions)
  "The place below END of the instruction that costs nothing besides that at INDEX; nil: there is none."
  (destructuring-bind (operation . operands) (aref instructions index)
    (let ((other (other-of-pair operation)))
      (and other (position (cons other operands) instructions :start (1+ index) :end end :test #'equal)))))

(defun block-form (program start end places finish)
  "The instructions from START to END, with the results that they complete; see COMPILED-PROGRAM."
  (let ((loads '()) (names (make-hash-table :test 'equal)) (bindings '()) (stores '()) (pair nil)
        (instructions (program-instructions program)))
    (labels ((local (operand form)
               (or (gethash operand names)
                   (let ((name (make-symbol (format nil "X~d" (hash-table-count names)))))
                     (push (list name form) loads)
                     (setf (gethash operand names) name))))
             (operand-form (operand)
               (cond ((null operand) nil)
                     ((integerp operand)
                      (if (>= operand start)
                          (gethash operand names)
                          (local operand `(aref work ,(aref places operand)))))
                     ((eq :input (car operand)) (local operand `(aref in ,(cdr operand))))
                     (t (number-of-operand operand))))
             (bind (index form)
               (let ((name (make-symbol (format nil "T~d" index))))
                 (setf (gethash index names) name)
                 (push (list name form) bindings)
                 (when (aref places index) (push `(setf (aref work ,(aref places index)) ,name) stores)))))
      (loop for index from start below end
            unless (gethash index names)
              do (destructuring-bind (operation a &optional b) (aref instructions index)
                   (let ((partner (partner-below end index instructions)))
                     (if partner
                         (destructuring-bind (form other)
                             (pair-forms operation (operand-form a) (or pair (setq pair (make-symbol "PAIR"))))
                           (bind index form)
                           (bind partner other))
                         (bind index (guarded-form operation (operand-form a) (operand-form b) index))))))
      (if finish
          (setq stores (reverse (funcall finish (mapcar #'operand-form (program-results program)))))
          (loop for result in (program-results program)
                for k from 0
                do (when (if (integerp result) (and (<= start result) (< result end)) (zerop start))
                     (push `(setf (aref out ,k) ,(operand-form result)) stores))))
      `(lambda (in out)
         (declare (type (simple-array double-float (*)) in out) (ignorable in out) ,*fast-code*)
         (,(if (overflowing-p instructions start end) 'with-infinities 'progn)
          (let* (,@(and (some #'identity places) '((work work)))       ; GCL knows no type of a closed-over variable
                 ,@(and pair `((,pair (make-array 2 :element-type 'double-float))))
                 ,@(reverse loads) ,@(reverse bindings))
            (declare ,@(and (some #'identity places) '((type (simple-array double-float (*)) work)))
                     ,@(and pair `((dynamic-extent ,pair) (type (simple-array double-float (2)) ,pair)))
                     (double-float ,@(mapcar #'first loads) ,@(mapcar #'first bindings))
                     (ignorable ,@(mapcar #'first loads)))
            ,@(reverse stores)
            nil))))))

;;; Compilation

(defun c-compiler-p ()
  "Nil if the C compiler that this Lisp calls is certainly missing: GCL would complain aloud."
  #+gcl (let ((program (subseq compiler::*cc* 0 (position #\Space compiler::*cc*))))
          (or (not (find #\/ program)) (probe-file program)))
  #-gcl t)

(defun quietly-compiled (form &optional name)
  "The function of the lambda expression FORM, also called NAME; without a compiler, what the Lisp has instead of one."
  (let* ((silence (make-broadcast-stream))
         (*standard-output* silence)
         (*error-output* silence)
         (*compile-verbose* nil)
         (*compile-print* nil)
         ;; no warnings; no symbols for debuggers, which saves a third of the time; square roots without a detour
         #+gcl (compiler::*cc* (concatenate 'string compiler::*cc* " -w -g0 -fno-math-errno"))
         #+gcl (compiler:*suppress-compiler-notes* t)
         #+gcl (compiler:*suppress-compiler-warnings* t))
    (multiple-value-bind (function warned failed)
        (handler-case (if (c-compiler-p) (compile name form) (values nil t t)) (error () (values nil t t)))
      (declare (ignorable warned failed))
      (if (and function #+ecl (not failed))
          (if name (symbol-function name) function)
          (progn #+ecl (ext:install-bytecodes-compiler)
                 (coerce form 'function))))))

(defun one-block-p (program) (<= (program-length program) *block-size*))

(defun compiled-program (program &optional finish)
  "A function of two arrays, in and out, where the results go; or, of a program of one block, with them is done what
FINISH says, a function of their forms that gives a list of forms."
  (multiple-value-bind (blocks size) (block-forms program finish)
    (let* ((work (make-array size :element-type 'double-float))
           (guards (program-guards program))
           (functions (compiled-blocks blocks work guards)))
      (if (null (rest functions))
          (first functions)
          (lambda (in out)
            (dolist (function functions)
              (funcall (the function function) in out)))))))

(defun compiled-blocks (blocks work guards)
  (flet ((maker (blocks)
           `(lambda (work guards)
              (declare (type (simple-array double-float (*)) work) (ignorable work guards) ,*fast-code*)
              (list ,@blocks))))
    #+sbcl (mapcan (lambda (block) (funcall (quietly-compiled (maker (list block))) work guards)) blocks)
    #+gcl (if (rest blocks)
              (funcall (quietly-compiled (maker blocks)) work guards)
              (list (named-block (first blocks) guards)))
    #-(or sbcl gcl) (funcall (quietly-compiled (maker blocks)) work guards)))

#+gcl
(defvar *named-blocks* 0)

#+gcl
(defun named-block (block guards)
  "A function that is called without GCL's usual ado, since it has a name and its type is known; it is no closure,
so the name also holds the guards."
  (let ((name (intern (format nil "BLOCK-~d" (incf *named-blocks*)) :anmech)))
    (proclaim `(ftype (function (t t) t) ,name))
    (set name guards)
    (quietly-compiled (subst `(symbol-value ',name) 'guards block) name)))

(defun expressions-program (expressions inputs &key (round-constants t))
  "The straight-line program of EXPRESSIONS in INPUTS.  With ROUND-CONSTANTS it is meant for doubles: sqrt(2) is one."
  (let ((*round-constants* round-constants))
    (with-graph
      (let ((index -1) (vertices (mapcar #'declare-input inputs)))
        (dolist (vertex vertices) (setf (vertex-value vertex) (cons :input (incf index)))))
      (straight-line (mapcar #'term-of expressions)))))

(defun same-form (first second)
  "Whether two expressions are equal but for the marks of the simplifier."
  (cond ((eq first second))
        ((or (atom first) (atom second)) (equal first second))
        (t (and (eq (caar first) (caar second))
                (eq (null (member 'maxima::array (cdar first))) (null (member 'maxima::array (cdar second))))
                (same-arguments (rest first) (rest second))))))

(defun same-arguments (first second)
  (and (= (length first) (length second)) (every #'same-form first second)))

(defun general-forms (expressions)
  "EXPRESSIONS, none of them in Maxima's form for rational expressions."
  (mapcar #'maxima::$totaldisrep expressions))

(defvar *compiled-programs* '() "A few (expressions inputs kind . values), the last used first.")
(defparameter *most-compiled-programs* 16)

(defun compiled-before (expressions inputs kind make)
  "The values of MAKE, a function of EXPRESSIONS without Maxima's form for rational ones; or, if it was called for the
same expressions, inputs and KIND, those of then."
  (let* ((expressions (general-forms expressions))
         (entry (find-if (lambda (entry)
                           (and (same-arguments (second entry) inputs) (equal kind (third entry))
                                (same-arguments (first entry) expressions)))
                         *compiled-programs*)))
    (unless entry
      (setq entry (list* expressions inputs kind (multiple-value-list (funcall make expressions)))))
    (setq *compiled-programs* (cons entry (remove entry *compiled-programs* :test #'eq)))
    (when (> (length *compiled-programs*) *most-compiled-programs*)
      (setq *compiled-programs* (butlast *compiled-programs*)))
    (values-list (rest (rest (rest entry))))))

(defun compile-expressions (expressions inputs)
  "A function (in out) that reads the values of INPUTS, variables of Maxima, from the double array IN and writes those
of EXPRESSIONS to OUT; and the program that it was made of."
  (compiled-before expressions inputs nil
                   (lambda (expressions)
                     (let ((program (expressions-program expressions inputs)))
                       (values (compiled-program program) program)))))

(defun operation-count (expressions)
  "The number of operations and function calls that EXPRESSIONS take once what they share is shared."
  (let ((expressions (general-forms expressions)))
    (program-length (expressions-program expressions (expressions-inputs expressions)))))

(defun expressions-inputs (expressions)
  "The variables in EXPRESSIONS."
  (let ((found (make-hash-table :test 'equal)) (list '()))
    (labels ((note (variable)
               (let ((plain (plain-form variable)))
                 (unless (gethash plain found)
                   (setf (gethash plain found) t)
                   (push plain list))))
             (visit (expression)
               (cond ((numberp expression))
                     ((symbolp expression) (unless (assoc expression *constants*) (note expression)))
                     ((atom expression))
                     ((member 'maxima::array (cdar expression)) (note expression))
                     ((member (caar expression) '(maxima::rat maxima::bigfloat)))
                     (t (mapc #'visit (rest expression))))))
      (mapc #'visit expressions)
      (nreverse list))))
