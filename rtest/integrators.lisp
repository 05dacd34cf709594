;;;; integrators.lisp: what rtest_integrators.mac asks.  Loading it adds the methods of toy_methods.lisp.
;;;;
;;;;   names_of_methods_in_shared_code()   [file, method] for each file of numerics/ outside of integrators/, and each
;;;;                                       module of motions, that holds the name of a method as a symbol, a text or a
;;;;                                       value
;;;;   program_values(m, numbers, type)    what the program of the motion's equations gives for these values of its
;;;;                                       inputs; type: compiled, doubles, rationals, bigfloats
;;;;   series_coefficients(m, numbers, order, type)   Taylor coefficients of the states, from the series program
;;;;   straight_code_agrees(m, order)      whether the two ways to them give the same bits
;;;;   exact_program_values(m, numbers)    the same in bigfloats, of the program with exact constants
;;;;   even_within(m)                      whether states within steps of m pass for as good as their ends
;;;;   most_steps(n)                       how many steps are taken where nobody says; the number before
;;;;   fixnum_forms()                      forms of fixnums that fix declares otherwise than they are, or changes

(in-package :anmech)

(mapc #'load-kernel
      '("numerics/accuracy" "numerics/equal_steps" "numerics/evaluation" "numerics/methods" "numerics/series_code"
        "numerics/series_program"))
(integrators)
(let ((source (concatenate 'string anmech-tests::*root* "rtest/toy_methods.lisp"))
      (binary (format nil "~a/toy_methods.~a" maxima::$maxima_tempdir
                      (pathname-type (compile-file-pathname "toy.lisp")))))
  (load (or (and (compiler-p) (compile-quietly source binary)) source)))

;;; Names

(in-package :anmech-tests)

(load (concatenate 'string *root* "rtest/sources.lisp"))

(defun names-of-methods ()
  "Those of the package: of the files."
  (mapcar #'pathname-name (files-of "src/numerics/integrators/*.lisp")))

(defun shared-files ()
  "Kernel files of numbers and modules that must know no method: all but the methods' own."
  (let ((own (loop for integrator in (anmech::integrators)
                   for module = (anmech::integrator-module integrator)
                   when module collect (concatenate 'string *root* "share/anmech/" module ".mac"))))
    (remove-if (lambda (file) (or (search "/integrators/" file) (member file own :test #'string=)))
               (append (files-of "src/numerics/*.lisp") (files-of "share/anmech/motion/*.mac")))))

(defun holds-p (file word)
  (with-open-file (stream file)
    (loop for line = (read-line stream nil)
          while line
            thereis (some (lambda (mark) (search (concatenate 'string mark word) line :test #'char-equal))
                          '("\"" "= " "'" "$")))))

(in-package :maxima)

(defmfun $names_of_methods_in_shared_code ()
  (cons '(mlist simp)
        (loop for file in (anmech-tests::shared-files)
              append (loop for name in (anmech-tests::names-of-methods)
                           when (anmech-tests::holds-p file name)
                             collect (list '(mlist simp) (anmech-tests::name-of-file file) name)))))

;;; Patience

(defmfun $most_steps (number)
  (prog1 anmech::*most-steps* (setq anmech::*most-steps* number)))

;;; Numbers of other types

(in-package :anmech)

(defun rational-operation (operation a &optional b)
  (ecase operation
    (:add (+ a b))
    (:subtract (- a b))
    (:multiply (* a b))
    (:divide (if (zerop b) nil (/ a b)))
    (:negate (- a))
    (:abs (abs a))))

(defvar *rationals* (make-number-type :number #'identity :constant #'error :operate #'rational-operation))

(defun bigfloat-operation (operation a &optional b)
  (flet ((value (operator &rest arguments) (maxima::$bfloat (maxima::simplify (cons (list operator) arguments)))))
    (ecase operation
      (:add (value 'maxima::mplus a b))
      (:subtract (value 'maxima::mplus a (value 'maxima::mtimes -1 b)))
      (:multiply (value 'maxima::mtimes a b))
      (:divide (value 'maxima::mtimes a (value 'maxima::mexpt b -1)))
      (:negate (value 'maxima::mtimes -1 a))
      (:expt (value 'maxima::mexpt a b))
      (:exp (value 'maxima::mexpt 'maxima::$%e a))
      (:atan2 (maxima::$bfloat (maxima::mfuncall 'maxima::$atan2 a b)))
      ((:sqrt :sin :cos :tan :log :asin :acos :atan :sinh :cosh :tanh :asinh :acosh :atanh :signum)
       (value (intern (format nil "%~a" operation) :maxima) a)))))

(defvar *bigfloats*
  (make-number-type :number (lambda (number) (maxima::$bfloat (from-rational number)))
                    :constant #'maxima::$bfloat
                    :operate #'bigfloat-operation))

(defun model-of (motion) (motion-model (first (last motion))))

(defun compiled-values (model numbers)
  (let ((out (zeros (length (program-results (model-program model))))))
    (funcall (model-system model) (doubles (mapcar (lambda (number) (to-double (exact-value number))) numbers)) out)
    (coerce out 'list)))

(defun interpreted-values (program type numbers)
  (flet ((input (number) (funcall (number-type-number type) (exact-value number))))
    (funcall (program-function program type) (map 'vector #'input numbers))))

(maxima::defmfun maxima::$program_values (motion numbers type)
  (let* ((model (model-of motion)) (program (model-program model)) (numbers (rest numbers)))
    (cons '(maxima::mlist maxima::simp)
          (ecase type
            (maxima::$compiled (compiled-values model numbers))
            (maxima::$doubles (interpreted-values program *doubles* numbers))
            (maxima::$rationals (mapcar #'from-rational (interpreted-values program *rationals* numbers)))
            (maxima::$bigfloats (interpreted-values program *bigfloats* numbers))))))

(maxima::defmfun maxima::$exact_program_values (motion numbers)
  (cons '(maxima::mlist maxima::simp)
        (interpreted-values (model-exact-program (model-of motion)) *bigfloats* (rest numbers))))

;;; Declared types

(maxima::defmfun maxima::$fixnum_forms ()
  "fixnum_forms(): those of some forms whose expansion by FIX has another value or names a type that is none."
  (labels ((sound-p (form)
             (or (atom form)
                 (and (or (not (eq 'the (first form))) (eq 'fixnum (second form)))
                      (every #'sound-p (rest form)))))
           (right-p (form)
             (let ((expanded (macroexpand-all-of `(fix ,form))))
               (and (sound-p expanded) (eql (eval form) (eval expanded)))))
           (macroexpand-all-of (form)
             (cond ((atom form) form)
                   ((eq 'fix (first form)) (macroexpand-all-of (macroexpand-1 form)))
                   (t (mapcar #'macroexpand-all-of form)))))
    (cons '(maxima::mlist maxima::simp)
          (mapcar (lambda (form) (format nil "~(~s~)" form))
                  (remove-if #'right-p
                             '(7 (- 5) (+ 5) (- 9 2 3) (+ 1 (* 2 3)) (- (the fixnum (+ 4 1)) 2)
                               (- (the fixnum (floor (the fixnum 9) 2)) 1) (* 2 (length (list 1 2)))
                               (+ (aref (vector 4 5) 1) 1)))))))

;;; Power series

(maxima::defmfun maxima::$series_coefficients (motion numbers order type)
  "series_coefficients(m, numbers, order, type): for each state the list of its Taylor coefficients where the inputs of
the equations have these values; type: doubles, rationals, bigfloats."
  (let* ((type (ecase type
                 (maxima::$doubles *doubles*) (maxima::$rationals *rationals*) (maxima::$bigfloats *bigfloats*)))
         (series (model-series-program (model-of motion) (not (eq type *doubles*))))
         (in (map 'vector (lambda (number) (funcall (number-type-number type) (exact-value number))) (rest numbers))))
    (flet ((number (x) (if (eq type *rationals*) (from-rational x) x)))
      (maxima-list (map 'list (lambda (row) (maxima-list (map 'list #'number row)))
                        (funcall (series-evaluator series type) in order))))))

(maxima::defmfun maxima::$straight_code_agrees (motion order)
  "straight_code_agrees(m, order): whether straight code gives the same numbers as the loop, where the motion begins;
also where entries of linear equations, if there are some, are changed a little."
  (let* ((record (first (last motion))) (kernel (new-kernel (model-series-program (motion-model record))))
         (start (motion-start record)) (size (series-kernel-size kernel)) (linear (series-kernel-linear kernel))
         (first (zeros size)) (second (zeros size)))
    (straight-code-for kernel (1+ order))
    (flet ((agree (factors)
             (dolist (work (list first second))
               (place-constants kernel start work)
               (place-unit kernel work 0.25d0)
               (dotimes (i (1+ (motion-dimension record))) (setf (aref work (* +room+ i)) (aref start i))))
             (expand kernel first order factors)
             (expand-series kernel second order factors)
             (and (equalp first second) (> (count-if-not #'zerop first) order))))
      (and (agree nil)
           (or (null linear)
               (agree (doubles (loop for factor from 1d0 by 1d-5
                                     repeat (length (linear-kernel-entries linear)) collect factor))))
           t))))

;;; Steps taken again

(maxima::defmfun maxima::$even_within (motion)
  "even_within(m): whether states within steps of m pass for as good as their ends."
  (and (integration-even (motion-integration (first (last motion)))) t))

(maxima::defmfun maxima::$states_by_steps (motion time)
  "states_by_steps(m, time): the state by the step there, and by steps of its own that stand for it."
  (let* ((record (first (last motion))) (integration (motion-integration record)) (n (motion-dimension record))
         (times (integration-times integration)) (place (step-place times time)) (model (motion-model record))
         (problem (make-problem :model model :field (model-field model) :n n :start (motion-start record)
                                :end (motion-reached record)))
         (small (doubles (make-list n :initial-element 1d-9)))
         (run (new-run *dop853* problem (make-tolerance :relative 1d-9 :absolute small) 10 nil))
         (state (zeros n)) (other (zeros n)))
    (state-of-step integration place state)
    (place-run run state 0 (aref times place))
    (begin-dop853 run)
    (attempt-until run (aref times (1+ place)))
    (dense-value integration time state)
    (funcall (state-by-steps run (aref times place)) time other)
    (maxima-list (list (numbers-list state) (numbers-list other)))))
