;;; anmech: functions that expressions leave open, and their definitions.
;;;
;;; A definition is F(u, v) = expr, the u, v different symbols; or the function is one that the user has defined in the
;;; session, perhaps after the expression was made.  Expressions are in jets, in which derivatives of such functions are
;;; partial ones, so that they can be taken once the function is known.
;;;
;;; Entry points: $anmech_is_definition, $anmech_with_definitions, $anmech_open_functions.

(in-package :anmech)
(needs "session/scope" "algebra/terms" "numerics/dag")

(defun application-p (form)
  "Whether FORM is F(..) with a function F that has no meaning for the package."
  (and (consp form)
       (symbolp (caar form))
       (find (char (symbol-name (caar form)) 0) "$%")
       (not (member 'maxima::array (cdar form)))
       (not (member (caar form) '(maxima::%derivative maxima::$matrix maxima::%at maxima::%integrate maxima::%sum
                                  maxima::%product maxima::%limit maxima::%lsum
                                  maxima::$rootsof maxima::%rootsof)))
       (not (assoc (function-name (caar form)) *functions*))
       (not (get (caar form) 'maxima::grad))
       (not (get (caar form) 'maxima::operators))))

(defun function-definition-p (form)
  (and (operator-p form 'maxima::mequal)
       (application-p (second form))
       (rest (second form))
       (every (lambda (name) (and name (symbolp name) (not (maxima::$constantp name)))) (rest (second form)))
       (null (duplicates (rest (second form))))))

(defun duplicates (names)
  (loop for (name . others) on names when (member name others) collect name))

(defun same-function-p (first second)
  "F(t) and 'F(t) are applications of the same function."
  (eq (maxima::$verbify first) (maxima::$verbify second)))

(defun defined-value (form definitions)
  "The value of the application FORM by one of DEFINITIONS or by the session; nil if there is none."
  (let ((definition (find-if (lambda (definition)
                               (and (same-function-p (caar form) (caar (second definition)))
                                    (= (length form) (length (second definition)))))
                             definitions))
        (function (maxima::$verbify (caar form))))
    (cond (definition (put-for-arguments (rest (second definition)) (rest form) (third definition)))
          ((maxima::mget function 'maxima::mexpr)
           (let ((value (maxima::mapply1 function (rest form) function nil)))
             (unless (maxima::alike1 value form) value))))))

(defun put-for-arguments (names arguments form)
  "FORM with ARGUMENTS in the places of NAMES, all at once."
  (maxima::mfuncall 'maxima::$sublis
                    (maxima-list (mapcar (lambda (name argument) `((maxima::mequal maxima::simp) ,name ,argument))
                                         names arguments))
                    form))

(defun with-definitions (form definitions)
  "FORM with the functions that are defined put in, and their derivatives taken."
  (labels ((walk (form depth)
             (if (atom form)
                 form
                 (let* ((inner (mapcar (lambda (part) (walk part depth)) (rest form)))
                        (new (if (every #'eq inner (rest form)) form (with-arguments form inner))))
                   (cond ((and (not (eq new form)) (operator-p form 'maxima::%derivative))
                          (maxima::mapply1 'maxima::$diff inner 'maxima::$diff nil))
                         ((and (not (eq new form)) (operator-p form 'maxima::%at))
                          (maxima::mapply1 'maxima::$at inner 'maxima::$at nil))
                         ((and (application-p new) (< depth 10))
                          (let ((value (defined-value new definitions)))
                            (if value (walk value (1+ depth)) new)))
                         (t new))))))
    (walk form 0)))

(maxima::defmfun maxima::$anmech_is_definition (form)
  "anmech_is_definition(expr): whether it is of the form F(u, ..) = expr, with symbols u, .."
  (and (function-definition-p form) t))

(maxima::defmfun maxima::$anmech_with_definitions (form definitions)
  "anmech_with_definitions(expr, [F(u) = expr, ..]): with these functions, and those that the session has defined, put
in."
  (with-definitions form (rest definitions)))

(maxima::defmfun maxima::$anmech_open_functions (form)
  "anmech_open_functions(expr): the applications of functions without a meaning."
  (let ((found '()))
    (some-part (lambda (form)
                 (when (application-p form) (pushnew form found :test #'maxima::alike1))
                 nil)
               form)
    (maxima-list (nreverse found))))
