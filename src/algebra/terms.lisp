;;; anmech: looking into expressions, and putting them together.
;;;
;;; Entry points: anmech_size, anmech_functions_in, anmech_arguments_of, anmech_has_roots, anmech_root_bases,
;;; anmech_has_derivatives, anmech_joined, anmech_distinct, anmech_has_value, anmech_has_floats, anmech_is_free_of,
;;; anmech_mirrored; BRANCHED-P, ROOT-P, SOME-PART, SYMBOLS-IN, PLAIN-KEY; MAXIMA-LIST, FUNCTION-OF, SUM-OF, PRODUCT-OF,
;;; POWER-OF, WITH-ARGUMENTS.

(in-package :anmech)
(needs "session/scope")

(defun maxima-list (elements) (cons '(maxima::mlist maxima::simp) elements))

(defun function-of (name argument) (maxima::simplify (list (list name) argument)))

(defun sum-of (terms)
  (maxima::simplifya (cons '(maxima::mplus) terms) t))

(defun product-of (&rest factors)
  (maxima::simplifya (cons '(maxima::mtimes) factors) t))

(defun power-of (base exponent)
  (maxima::simplifya `((maxima::mexpt) ,base ,exponent) t))

(defun with-arguments (form arguments)
  "FORM with other arguments, simplified again; FORM itself if they are the same."
  (if (every #'eq arguments (rest form))
      form
      (maxima::simplifya (cons (remove 'maxima::simp (first form)) arguments) t)))

(defun some-part (test form)
  "Whether TEST holds for FORM or for an operator form inside it."
  (and (consp form)
       (or (funcall test form)
           (some (lambda (part) (some-part test part)) (rest form)))))

(defun symbols-in (form)
  (let ((found '()))
    (labels ((walk (form)
               (cond ((and form (symbolp form)) (pushnew form found))
                     ((consp form) (mapc #'walk (rest form))))))
      (walk form))
    found))

(defun plain-key (variable)
  "A key equal for equal variables: a symbol, or a subscripted variable without flags."
  (if (consp variable)
      (cons (list (caar variable)) (mapcar #'plain-key (rest variable)))
      variable))

(defun root-p (form)
  (and (eq (caar form) 'maxima::mexpt) (not (integerp (third form))) (operator-p (third form) 'maxima::rat)))

(defun branched-p (form)
  "Whether FORM has roots, logarithms or the like, whose identities hold for positive arguments only."
  (some-part (lambda (form)
               (or (member (caar form) '(maxima::%log maxima::%acos maxima::%asin maxima::%acosh maxima::%atanh
                                     maxima::%atan2 maxima::$atan2))
                   (and (eq (caar form) 'maxima::mexpt) (not (integerp (third form)))
                        (not (eq (second form) 'maxima::$%e)))))
             form))

(maxima::defmfun maxima::$anmech_has_roots (form)
  "anmech_has_roots(expr): whether a fractional power of something occurs."
  (and (some-part #'root-p form) t))

(maxima::defmfun maxima::$anmech_root_bases (form)
  "anmech_root_bases(expr): what square roots are taken of."
  (let ((found '()))
    (some-part (lambda (form)
                 (when (and (root-p form) (eql (third (third form)) 2))
                   (pushnew (second form) found :test #'maxima::alike1))
                 nil)
               form)
    (cons '(maxima::mlist maxima::simp) found)))

(maxima::defmfun maxima::$anmech_has_derivatives (form)
  "anmech_has_derivatives(expr): whether a derivative occurs that diff left as it is."
  (and (some-part (lambda (form) (eq (caar form) 'maxima::%derivative)) form) t))

(maxima::defmfun maxima::$anmech_size (form)
  "anmech_size(expr): how many operators and atoms it has."
  (labels ((weight (form)
             (if (atom form) 1 (1+ (loop for part in (rest form) sum (weight part))))))
    (weight form)))

(maxima::defmfun maxima::$anmech_arguments_of (form functions)
  "anmech_arguments_of(expr, [function, ...]): the arguments with which these functions of one argument occur."
  (let ((found '()) (operators (mapcar #'maxima::$nounify (rest functions))))
    (labels ((walk (form)
               (when (consp form)
                 (when (member (caar form) operators)
                   (pushnew (second form) found :test #'maxima::alike1))
                 (mapc #'walk (rest form)))))
      (walk form))
    (cons '(maxima::mlist maxima::simp) (nreverse found))))

(maxima::defmfun maxima::$anmech_functions_in (form variables)
  "anmech_functions_in(expr, [x, ...]): what sums, products and whole powers that depend on the variables are made of,
but for symbols; also of a list."
  (let ((found '()))
    (labels ((walk (form)
               (cond ((atom form))
                     ((or (member (caar form) '(maxima::mlist maxima::mplus maxima::mtimes maxima::mminus
                                                maxima::mquotient))
                          (and (eq (caar form) 'maxima::mexpt) (integerp (third form))))
                      (mapc #'walk (rest form)))
                     ((notevery (lambda (variable) (maxima::$freeof variable form)) (rest variables))
                      (pushnew form found :test #'maxima::alike1)))))
      (walk form))
    (maxima::$sort (maxima-list found))))

(maxima::defmfun maxima::$anmech_joined (lists)
  "anmech_joined([[a, ..], [b, ..], ..]): [a, .., b, ..].  A function may not have as many arguments as a list may have
entries."
  (maxima-list (loop for list in (rest lists) append (rest list))))

(maxima::defmfun maxima::$anmech_distinct (list)
  "anmech_distinct(list): without repetitions, in the same order."
  (let ((seen (make-hash-table :test #'equal)))
    (maxima-list (loop for form in (rest list)
                       for key = (plain-key form)
                       unless (gethash key seen)
                         do (setf (gethash key seen) t)
                         and collect form))))

(maxima::defmfun maxima::$anmech_has_value (symbol)
  "anmech_has_value(x): whether the symbol x is evaluated to something else."
  (and (symbolp symbol) (boundp symbol)))

(maxima::defmfun maxima::$anmech_has_floats (form)
  "anmech_has_floats(expr): whether a floating-point number occurs in it."
  (if (atom form) (floatp form) (some #'maxima::$anmech_has_floats (rest form))))

(maxima::defmfun maxima::$anmech_mirrored (rows)
  "anmech_mirrored([[a], [b, c], ..]): the symmetric matrix of which these are the rows up to the diagonal."
  (let* ((rows (map 'vector (lambda (row) (coerce (rest row) 'vector)) (rest rows))) (size (length rows)))
    (cons '(maxima::$matrix maxima::simp)
          (loop for i below size
                collect (maxima-list (loop for j below size
                                           collect (aref (aref rows (max i j)) (min i j))))))))

;;; (GCL calls no function with more than a hundred arguments, so apply('freeof, ..) and apply('append, ..) fail there.)
(maxima::defmfun maxima::$anmech_is_free_of (variables form)
  "anmech_is_free_of([x, ...], expr): whether expr holds none of them."
  (every (lambda (variable) (maxima::$freeof variable form)) (rest variables)))
