;;;; verbs.lisp: what rtest_verbs.mac asks, of all public verbs at once.
;;;;
;;;; The problems are the examples of the manual: every public verb has one there, so a new verb is tested here without
;;;; being listed anywhere.  An example is run once, in a session of its own, in circumstances that must not matter:
;;;; with other names for its variables, with Maxima's options at hostile values, and with variables bound while a verb
;;;; works.  What it gives as it stands is known from the manual, and is tested with it (rtest_manual.mac).
;;;;
;;;;   hostile_examples(names)      runs a third of the examples so, another one on each Lisp, their variables named
;;;;                                from NAMES on, and watches every call of a verb: the inputs whose result, with the
;;;;                                old names, is not the one in the manual, as lists [input, result, in the manual]
;;;;   number_of_examples()         how many there were
;;;;   names_made(f, n)             how many symbols n calls of f() leave in Maxima's package for ever
;;;;   traces_of_examples()         what the calls of that run have left behind: lists [verb, what, ...]
;;;;   verbs_without_example()      public verbs that stand in no example's input but in some that end with an error
;;;;   local_names()                the names of all local variables in the modules
;;;;   traces(expr)                 what calls of verbs in expr leave behind: so that the watch can be tested too
;;;;   define_verb(name(..) := ..)  makes name a public verb, as a module would; remove_verb(name) takes it away

(in-package :anmech-tests)

(load (concatenate 'string *root* "rtest/manual.lisp"))

;;; Examples

(defstruct example
  "INPUTS, a list of Maxima expressions, and what is RECORDED in the manual for each."
  inputs recorded)

(defun read-examples ()
  "Every example of the manual."
  (loop for steps in (examples-of (anmech-manual::manual-file "anmech.texi"))
        collect (make-example :inputs (mapcar #'input-of steps) :recorded (mapcar #'recorded-result steps))))

(defun share-of-this-lisp (examples)
  "Some of them: what is watched here, names and options, is the same on every Lisp, so those that compile part the
examples between them."
  (loop with shares = (or #+gcl '(0) #+sbcl '(1 2) '(0 1 2))
        for example in examples
        for place from 0
        when (member (mod place 3) shares) collect example))

(defun parsed-step (step)
  (anmech::parsed (anmech-manual::input-text (anmech-manual::example-step-lines step))))

(defun input-of (step) (values (parsed-step step)))

(defun recorded-result (step)
  "The result in the manual; nil for an input that ends with $."
  (let ((value-text (anmech-manual::recorded-value-text step)) (silent-p (nth-value 1 (parsed-step step))))
    (cond (value-text (make-result :value (anmech-manual::value-of value-text)))
          ((not silent-p) (make-result :problem (anmech-manual::recorded-text step))))))

(defstruct result
  "VALUE of an input, or the text of its error in PROBLEM."
  value problem)

(defun symbols-in-examples ()
  "All that stand in inputs whose result is no error."
  (loop for example in (read-examples)
        append (loop for input in (example-inputs example)
                     for recorded in (example-recorded example)
                     unless (and recorded (result-problem recorded)) append (symbols-of input))))

(defun result-of (input index)
  (let* ((maxima::$errormsg nil) (maxima::$ratprint nil) (answer nil))
    (with-output-to-string (*standard-output*)
      (setq answer (maxima::meval* `((maxima::$errcatch) ,input))))
    (cond ((maxima::$emptyp answer) (make-result :problem (anmech-manual::last-error-text)))
          (t
           (set (anmech-manual::label "O" index) (second answer))
           (setq maxima::$% (second answer))
           (make-result :value (second answer))))))

(defun results-of (inputs)
  "The results of INPUTS, in a session of their own."
  (anmech-manual::start-example)
  (loop for input in inputs
        for index from 1
        collect (result-of input index)))

(defun same-result-p (a b)
  "Errors are the same if the same verb complains."
  (if (or (result-problem a) (result-problem b))
      (and (result-problem a) (result-problem b)
           (equal (complainer (result-problem a)) (complainer (result-problem b))))
      (same-value-p (comparable (result-value a)) (comparable (result-value b)))))

(defun comparable (form)
  "FORM without what cannot be the same twice: the seconds that a computation took, objects of Lisp; and strings,
which may speak of variables."
  (cond ((stringp form) 'text)
        ((atom form) (if (or (symbolp form) (numberp form)) form 'object))
        (t (cons (first form)
                 (mapcar #'comparable
                         (remove-if (lambda (part)
                                      (and (anmech::operator-p part 'maxima::mequal)
                                           (eq (second part) 'maxima::$seconds)))
                                    (rest form)))))))

(defun complainer (text)
  "The verb that an error names."
  (subseq text 0 (position #\: text)))

;;; The state of a session

(defparameter *lists-of-names*
  '(maxima::$values maxima::$functions maxima::$macros maxima::$arrays maxima::$dependencies maxima::$gradefs
    maxima::$rules maxima::$let_rule_packages maxima::$aliases maxima::$props maxima::$structures maxima::$contexts
    maxima::$activecontexts maxima::$myoptions maxima::tellratlist))

(defvar *names* (vector) "The symbols whose values and properties make up a state.")

(defun collect-names ()
  "All symbols that a user can type, and their nouns; the variables where Maxima keeps its order of kernels."
  (let ((names (make-hash-table :test #'eq)))
    (do-symbols (symbol :maxima)
      (let ((name (symbol-name symbol)))
        (when (and (> (length name) 1) (find (char name 0) "$%") (not (find #\' name)) (not (find #\` name)))
          (setf (gethash symbol names) t))))
    (dolist (name *lists-of-names*) (remhash name names))
    (setq *names* (coerce (list* 'maxima::varlist 'maxima::genvar
                                 (loop for name being the hash-keys of names collect name))
                          'vector))))

(defstruct state
  "LISTS: the lists of names, FACTS: those of every context, VALUES and PROPERTIES: those of *names*; all copied as
far as Maxima changes them in place."
  lists facts values properties)

(defun state-now ()
  (make-state
   :lists (mapcar (lambda (name) (copy-list (symbol-value name))) *lists-of-names*)
   :facts (mapcar (lambda (context) (cons context (maxima::mfuncall 'maxima::$facts context))) (rest maxima::$contexts))
   :values (map 'vector (lambda (name) (if (boundp name) (symbol-value name) *names*)) *names*)
   :properties (map 'vector (lambda (name) (copy-list (symbol-plist name))) *names*)))

(defun differences (before after)
  "What is not as it was, as strings."
  (append
   (loop for name in *lists-of-names*
         for old in (state-lists before)
         for new in (state-lists after)
         unless (equal old new) collect (format nil "~a" (text-of name)))
   (unless (equal (state-facts before) (state-facts after)) (list "facts"))
   (loop for name across *names*
         for old across (state-values before)
         for new across (state-values after)
         unless (or (eq old new) (equal old new)) collect (format nil "value of ~a" (text-of name)))
   (loop for name across *names*
         for old across (state-properties before)
         for new across (state-properties after)
         unless (or (equal old new) (equal (lasting old) (lasting new)) (helper-p name))
          collect (format nil "properties of ~a" (text-of name)))))

(defun helper-p (name)
  "Whether NAME belongs to the package, which may read a module of its own at any time."
  (eql 0 (search "$ANMECH_" (symbol-name name))))

(defun lasting (properties)
  "PROPERTIES without notes of Maxima's: of the assumption system at every comparison, and of nouns and verbs; and
without an empty list of facts, which says what no list says."
  (loop for (name value) on properties by #'cddr
        unless (or (member name '(maxima::+labs maxima::-labs maxima::ulabs maxima::noun maxima::verb))
                   (and (eq name 'maxima::data) (null value)))
          collect name and collect value))

;;; Watching the calls

(defvar *watched* nil
  "What to do at each call of a verb: a function of the verb, of a function that makes the call, and of its
arguments.")

(defun watched-verb-form (form)
  "In place of anmech::call-verb-form: arguments are evaluated first, and the call itself is handed to *watched*."
  (if anmech::*verb*
      (anmech::call-verb-form form)
      (let ((ready (ready-form form)))
        (funcall *watched* (caar form) (lambda () (anmech::call-verb-form ready)) (rest ready)))))

(defun ready-form (form)
  "FORM with its arguments evaluated; the names of options stay."
  (let ((required (length (anmech::definition-required (anmech::verb-definition (caar form))))))
    (cons (first form)
          (loop for argument in (rest form)
                for place from 0
                collect (if (and (>= place required) (anmech::operator-p argument 'maxima::mequal)
                                 (symbolp (second argument)))
                            (list (first argument) (second argument) (quoted-value (third argument)))
                            (quoted-value argument))))))

(defun quoted-value (form)
  (list '(maxima::mquote) (maxima::meval form)))

(defun call-watched (watcher thunk)
  "The value of THUNK, every call of a verb from outside the package being handed to WATCHER."
  (flet ((install (function)
           (dolist (verb anmech::*verbs*) (setf (get verb 'maxima::mfexpr*) function))))
    (let ((*watched* watcher))
      (unwind-protect (progn (install 'watched-verb-form) (funcall thunk))
        (install 'anmech::call-verb-form)))))

;;; Traces

(defvar *examples* '())
(defvar *traces* '() "Lists (verb what ...) of what calls have left behind.")
(defvar *options* '() "An alist: values that a user might have given to Maxima's options.")

(defun user-names ()
  "The names in *options* that are none of Maxima's options, which it does not list among the values."
  (set-difference (mapcar #'car *options*) (mapcar #'car (hostile-options))))

(defun call-observed (verb call arguments)
  "The value of CALL, made with *options* set; what it leaves behind goes to *traces*."
  (progv (cons 'maxima::$values (mapcar #'car *options*))
      (cons (append maxima::$values (user-names)) (mapcar #'cdr *options*))
    (let ((before (state-now)) (copies (copy-tree arguments)) (failed t))
      (unwind-protect
           (multiple-value-prog1 (funcall call)
             (setq failed nil))
        (let ((found (set-difference
                      (append (differences before (state-now))
                              (unless (equal copies arguments) (list "arguments")))
                      (allowed-traces verb arguments failed) :test #'string=)))
          (when found (push (maxima-list (cons verb (sort found #'string<))) *traces*)))))))

(defun allowed-traces (verb arguments failed)
  "Maxima remembers an error; coordinates is the one verb that leaves something behind: it declares its arguments.  A
share package that is written in Lisp stays."
  (append (when failed (list "value of error"))
          (when (member verb '(maxima::$ritz maxima::$equilibria)) (list "properties of minpack_solve"))
          (when (and (eq verb 'maxima::$coordinates) (not failed))
            (append (list "dependencies" "props")
                    (mapcar (lambda (symbol) (format nil "properties of ~a" (text-of symbol)))
                            (symbols-of arguments))))))

(defun symbols-of (form)
  (if (consp form)
      (append (symbols-of (car form)) (symbols-of (cdr form)))
      (and form (symbolp form) (list form))))

;; GCL and ECL interpret this file, and every call of a verb asks for two states.
(handler-case (mapc #'compile '(state-now differences))
  (error () nil))

;;; Hostile options

(defparameter *hostile-values*
  '((maxima::$expop . 5) (maxima::$expon . 5) (maxima::$domain . maxima::$complex) (maxima::$gcd . nil)
    (maxima::$maxmin_effort . 0) (maxima::$ratwtlvl . 1) (maxima::$matrix_element_mult . ".")
    (maxima::$matrix_element_add . maxima::$f) (maxima::$ratvars . ((maxima::mlist) maxima::$y maxima::$x))
    (maxima::$logexpand . maxima::$super) (maxima::$radexpand . maxima::$all) (maxima::$linel . 15)
    (maxima::$fpprec . 5) (maxima::$fpprintprec . 2) (maxima::$display2d . nil)
    (maxima::$stringdisp . t) (maxima::$lispdisp . t) (maxima::$obase . 7) (maxima::$sublis_apply_lambda . nil)
    (maxima::$triginverses . nil) (maxima::$maxposex . 1) (maxima::$maxnegex . 1) (maxima::$infeval . t)
    (maxima::$errormsg . nil)))

(defun hostile-options ()
  "Every option that the package sets, and some others, at a value that is not Maxima's own."
  (append *hostile-values*
          (loop for (option value) in anmech::*plain-options*
                unless (assoc option *hostile-values*)
                  collect (cons option (not value)))))

(defun bound-names (inputs)
  "All names of local variables, all variables of INPUTS and the time, with a value: arguments have been evaluated
when it is put on, and inside a verb nothing is evaluated a second time."
  (mapcar (lambda (name) (cons name 13))
          (remove-duplicates (cons 'maxima::$t (append (local-names) (variables-of inputs))))))

(defun hostile-results (inputs)
  (let ((*options* (append (hostile-options) (bound-names inputs))))
    (call-watched #'call-observed (lambda () (results-of inputs)))))

(defun changed-inputs (example results)
  "The inputs of EXAMPLE whose RESULTS are not those of the manual."
  (loop for input in (example-inputs example)
        for recorded in (example-recorded example)
        for result in results
        unless (or (null recorded) (same-result-p recorded result))
          collect (maxima-list (list* (text-of input) (mapcar #'result-text (list result recorded))))))

(defun result-text (result)
  (shortened (or (result-problem result) (text-of (result-value result))) 300))

;;; Other names

(defun plain-symbol-p (symbol)
  "A symbol that means nothing to Maxima or to the package: the name of a variable or an undefined function."
  (and symbol (symbolp symbol)
       (char= (char (symbol-name symbol) 0) #\$)
       (not (boundp symbol)) (not (fboundp symbol))
       (null (telling (symbol-plist symbol)))
       (not (member symbol (words-of-the-package)))))

(defun telling (properties)
  "PROPERTIES without those that say how a symbol prints, and its name, which GCL keeps there."
  (loop for (name value) on (lasting properties) by #'cddr
        unless (or (member name '(maxima::texword maxima::tex maxima::wxxmlword maxima::wxxml))
                   (stringp value))
          collect name))

(defun package-forms ()
  "The lambda expressions of all definitions that have been read."
  (let ((forms '()))
    (do-symbols (symbol :maxima)
      (let ((definition (anmech::definition-of symbol)))
        (when definition (push (anmech::definition-lambda definition) forms))))
    forms))

(defvar *words* nil)
(defvar *local-names* nil)

(anmech::load-kernel "numerics/methods")

(defun words-of-the-package ()
  "Names of options, fields and methods, and symbols that the modules quote: they mean something as a user writes them."
  (or *words*
      (setq *words*
            (append (loop for verb in anmech::*verbs*
                          append (mapcar #'first (anmech::definition-options (anmech::verb-definition verb))))
                    (names-of-fields)
                    (mapcar #'anmech::integrator-name (anmech::integrators))
                    (quoted-symbols (package-forms))))))

(defun names-of-fields ()
  "The fields of structures that users meet; other heads begin as all helpers do."
  (let ((names '()))
    (do-symbols (symbol :maxima names)
      (let ((shape (get symbol 'anmech::shape)))
        (when (and shape (not (eql 0 (search "$ANMECH_" (symbol-name symbol)))))
          (setq names (append (anmech::shape-fields shape) (mapcar #'car (anmech::shape-options shape)) names)))))))

(defun quoted-symbols (form)
  (cond ((atom form) '())
        ((and (anmech::operator-p form 'maxima::mquote) (symbolp (second form))) (list (second form)))
        ((and (anmech::operator-p form 'maxima::mquote) (anmech::operator-p (second form) 'maxima::mlist))
         (remove-if-not #'symbolp (rest (second form))))
        (t (loop for part = form then (cdr part)               ; along the list: all modules are one
                 while (consp part) append (quoted-symbols (car part))))))

(defun local-names ()
  "The names of all local variables in the modules, as their authors wrote them."
  (or *local-names* (setq *local-names* (find-local-names))))

(defun find-local-names ()
  (mapc #'anmech::verb-definition anmech::*verbs*)             ; reads all modules
  (let ((names '()))
    (labels ((walk (form)
               (cond ((consp form)
                      (loop while (consp form) do (walk (pop form)))      ; a call for each would be too many
                      (walk form))
                     ((and form (symbolp form))
                      (let ((end (position #\` (symbol-name form))))
                        (when end (pushnew (intern (subseq (symbol-name form) 0 end) :maxima) names)))))))
      (walk (package-forms)))
    (sort (remove-if-not #'plain-symbol-p names) #'string<)))

(defun variables-of (inputs)
  "The symbols of INPUTS that are names of their author's choice."
  (sort (remove-duplicates (remove-if-not #'plain-symbol-p (symbols-of inputs))) #'string<))

(defun new-names (inputs names)
  "An alist that gives each variable of INPUTS another name, one of NAMES.  Maxima arranges sums, and the package
lists, by names; their order among each other and relative to the time stays, so that results come back in the same
form."
  (let* ((taken (symbols-of inputs))
         (free (remove-if (lambda (name) (member name taken)) names)))
    (flet ((before-time-p (name) (precedes-p name 'maxima::$t)))
      (append (paired (remove-if-not #'before-time-p (variables-of inputs)) (remove-if-not #'before-time-p free))
              (paired (remove-if #'before-time-p (variables-of inputs)) (remove-if #'before-time-p free))))))

(defun precedes-p (a b)
  "Maxima's order of symbols."
  (maxima::great b a))

(defun paired (variables names)
  "VARIABLES and as many NAMES from the first ones, both in Maxima's order."
  (mapcar #'cons
          (sort (copy-list variables) #'precedes-p)
          (sort (subseq names 0 (length variables)) #'precedes-p)))

(defun with-prefixes (names)
  "NAMES, and what the package calls other variables after them, such as v_x."
  (append names
          (loop for prefix in (words-of-the-package)
                when (char= (char (symbol-name prefix) (1- (length (symbol-name prefix)))) #\_)
                  append (loop for (old . new) in names
                               collect (cons (maxima::mfuncall 'maxima::$concat prefix old)
                                             (maxima::mfuncall 'maxima::$concat prefix new))))))

(defun reversed (names)
  (loop for (old . new) in names collect (cons new old)))

(defun renamed-result (result names)
  (make-result :problem (result-problem result)
               :value (maxima::resimplify (sublis names (result-value result)))))

(defun results-with-other-names (inputs names)
  (let ((new (with-prefixes (new-names inputs names))))
    (mapcar (lambda (result) (renamed-result result (reversed new)))
            (hostile-results (sublis new inputs)))))

;;; A verb for a while

(defparameter *module* "a test")

(defun define-verb (statement)
  "STATEMENT, name(..) := .., defines a public verb as the statement of a module would."
  (setf (gethash *module* anmech::*loaded-modules*) t)
  (anmech::install-verb (caar (second statement)) *module*)
  (let ((anmech::*module* *module*)) (anmech::load-statement statement)))

(defun remove-verb (verb)
  (setq anmech::*verbs* (remove verb anmech::*verbs*))
  (dolist (property '(maxima::mfexpr* anmech::module anmech::definition)) (remprop verb property))
  (fmakunbound verb))

;;; The layer that Maxima sees

(in-package :maxima)

(defmfun $hostile_examples (names)
  (setq anmech-tests::*traces* '())
  (anmech-manual::with-examples
    (setq anmech-tests::*examples* (anmech-tests::share-of-this-lisp (anmech-tests::read-examples)))
    (maxima::$anmech_need "session/libraries.lisp")
    (anmech::call-with-library (lambda () 'nothing))           ; so that its names are among those observed
    (anmech-tests::collect-names)
    (anmech-tests::maxima-list
     (loop with names = (remove-duplicates (rest names) :from-end t)
           for example in anmech-tests::*examples*
           append (anmech-tests::changed-inputs
                   example
                   (anmech-tests::results-with-other-names (anmech-tests::example-inputs example) names))))))

(defmfun $number_of_examples ()
  (length anmech-tests::*examples*))

(defmfun $traces_of_examples ()
  (anmech-tests::maxima-list (reverse anmech-tests::*traces*)))

(defmfun $verbs_without_example ()
  (anmech-tests::maxima-list
   (set-difference anmech::*verbs* (anmech-manual::with-examples (anmech-tests::symbols-in-examples)))))

(defmfun $local_names ()
  (anmech-tests::maxima-list (anmech-tests::local-names)))

(defmspec $traces (form)
  (let ((anmech-tests::*traces* '()))
    (anmech-tests::collect-names)
    (anmech-tests::call-watched #'anmech-tests::call-observed (lambda () (meval `(($errcatch) ,(second form)))))
    (anmech-tests::maxima-list (reverse anmech-tests::*traces*))))

(defmspec $define_verb (form)
  (anmech-tests::define-verb (second form))
  '$done)

(defmfun $remove_verb (verb)
  (anmech-tests::remove-verb verb)
  '$done)

(defmfun $names_made (function count)
  (flet ((names () (let ((found 0)) (do-symbols (symbol :maxima found) (incf found)))))
    (let ((before (names)))
      (dotimes (i count) (mfuncall function))
      (- (names) before))))
