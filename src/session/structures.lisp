;;; anmech: structures, expressions that are their own constructor call; and entries, what kinds of structures answer.
;;;
;;; Entry points: anmech_structure, anmech_make, anmech_is, anmech_head; anmech_kinds, anmech_entry, anmech_ask,
;;; anmech_answers, anmech_with_article, anmech_registered; anmech_bound, anmech_call; anmech_shown_as; WITH-ARTICLE;
;;; *KINDS*, SHAPE; DISPLAY-STRUCTURE, TEX-STRUCTURE, WXXML-STRUCTURE.

(in-package :anmech)
(needs "session/prepared_code" "session/rows" "session/scope" "session/texts" "session/verbs")

;;; Structures: expressions that are their own constructor call, with fields

(defstruct shape
  "FIELDS are the names of the positional arguments, OPTIONS a list of (name . helper that gives an absent one's
value)."
  fields options)

(maxima::defmspec maxima::$anmech_structure (form)
  "anmech_structure(head(field, ..., [option = helper, ...])): objects of that form have these fields.
An option that an object does not carry has the value helper(object)."
  (let* ((template (second form))
         (head (caar template))
         (tail (first (last template)))
         (options-p (operator-p tail 'maxima::mlist)))
    (setf (get head 'shape)
          (make-shape :fields (if options-p (butlast (rest template)) (rest template))
                          :options (and options-p (mapcar (lambda (option) (cons (second option) (third option)))
                                                          (rest tail))))
          (get head 'begins-a-row) t
          (get head 'maxima::dimension) 'display-structure
          (get head 'maxima::tex) 'tex-structure
          (get head 'maxima::wxxml) 'wxxml-structure)
    'maxima::$done))

(defun shape-of (object)
  (and (consp object) (consp (car object)) (symbolp (caar object)) (get (caar object) 'shape)))

(maxima::defmfun maxima::$anmech_make (head &rest arguments)
  "anmech_make(head, arg, ...): the inert object head(arg, ...)."
  (cons (list head 'maxima::simp) arguments))

(maxima::defmfun maxima::$anmech_is (object &rest heads)
  "anmech_is(object, head, ...): whether it is a structure with one of these heads."
  (and (shape-of object) (member (caar object) heads) t))

(maxima::defmfun maxima::$anmech_head (object)
  "anmech_head(object): its head, or false if it is no structure of this package."
  (and (shape-of object) (caar object)))

(defun field-value (object field)
  (let* ((shape (shape-of object))
         (place (position field (shape-fields shape)))
         (option (assoc field (shape-options shape)))
         (carried (and option (find-if (lambda (argument)
                                         (and (operator-p argument 'maxima::mequal) (eq (second argument) field)))
                                       (nthcdr (length (shape-fields shape)) (rest object))))))
    (cond (place (nth place (rest object)))
          (carried (third carried))
          (option (maxima::mapply1 (cdr option) (list object) (cdr option) nil))
          (t (let ((*verb* (or *verb* (caar object))))
               (complain "no field ~a; the fields are ~a" (one-line field)
                         (english-list (append (shape-fields shape)
                                               (mapcar #'car (shape-options shape))))))))))

(let ((fields-of-others #'maxima::$@-function))
  (setf (symbol-function 'maxima::$@-function)
        (lambda (object field)
          (if (shape-of object) (field-value object field) (funcall fields-of-others object field)))))

(define-preparation maxima::$@ (form)
  (destructuring-bind (object-form field) (rest form)
    (let ((value (prepared object-form)))
      (lambda ()
        (let ((object (evaluate value)))
          (if (shape-of object)
              (simplified (field-value object field))
              (maxima::meval (list (first form) (list '(maxima::mquote) object) field))))))))

;;; Functions with some of their arguments given: what a lambda that is kept would be for, which does not keep the
;;; values of the variables around it.

(maxima::defmfun maxima::$anmech_bound (function &rest arguments)
  "anmech_bound('f, a, ...): f with its first arguments, to be called by anmech_call."
  (list* '(maxima::|$bound`| maxima::simp) function arguments))

(maxima::defmfun maxima::$anmech_call (function &rest arguments)
  "anmech_call(f, x, ...): f(x, ..); with the arguments before these that f has been given by anmech_bound."
  (if (operator-p function 'maxima::|$bound`|)
      (maxima::mapply1 (second function) (append (cddr function) arguments) (second function) nil)
      (maxima::mapply1 function arguments function nil)))

;;; Entries.  What is written once for many kinds of structures asks the entry of a kind for what it has of its own.
;;; Any module may add a question of its own to the entries of the kinds that can answer it; what a kind does not answer
;;; is an error.

(defvar *kinds* '() "The heads of structures that answer questions: constructors.")
(defvar *entries* (make-hash-table :test #'eq) "From a head to its entry, a list question, answer, ...")

(maxima::defmspec maxima::$anmech_kinds (form)
  "anmech_kinds(head, ...): what answers questions; their modules are read when one of them is met, or all are asked."
  (setq *kinds* (append *kinds* (set-difference (rest form) *kinds*)))
  'maxima::$done)

(maxima::defmspec maxima::$anmech_entry (form)
  "anmech_entry(head, question = answer, ...): what objects with this head answer: the name of a function of the object
and of what is asked beside it; or a number, a list or 'name; or, as a string, why there is no answer."
  (let ((head (second form)))
    (dolist (equation (cddr form) 'maxima::$done)
      (destructuring-bind (question answer) (rest equation)
        (setf (getf (gethash head *entries*) question)
              (if (or (atom answer) (operator-p answer 'maxima::mquote)) answer (maxima::simplify answer)))))))

(defun entry-of (head)
  "The entry is made when the module of the constructor is read; what other modules add may come before."
  (when (get head 'module) (verb-definition head))
  (gethash head *entries*))

(defun answer-of (object question)
  "The answer in the entry of OBJECT's kind, or nil."
  (let ((head (and (consp object) (consp (car object)) (caar object))))
    (and (symbolp head) (or (member head *kinds*) (shape-of object)) (getf (entry-of head) question))))

(defun answering-kinds (question)
  "Those that have an answer, as in  an a, b or c."
  (let ((names (loop for head in *kinds*
                     for answer = (getf (entry-of head) question)
                     when (and answer (not (stringp answer)))
                       collect (plain-name head))))
    (format nil "~a ~{~a~^, ~}~@[ or ~a~]" (article (first names)) (or (butlast names) names)
            (and (rest names) (first (last names))))))

(defun article (word)
  (if (find (char word 0) "aeiou") "an" "a"))

(defun with-article (name) (format nil "~a ~a" (article name) name))

(maxima::defmfun maxima::$anmech_with_article (head)
  "anmech_with_article(head): an ode_system, a hamilton_system."
  (with-article (plain-name head)))

(maxima::defmfun maxima::$anmech_ask (object question &rest more)
  "anmech_ask(object, 'question, ...): the answer of its kind; an error if there is none."
  (let ((answer (answer-of object question)))
    (cond ((stringp answer) (complain "~a" answer))
          ((null answer)
           (complain "expected ~a, found ~a" (answering-kinds question)
                     (if (shape-of object) (with-article (plain-name (caar object))) (one-line object))))
          ((operator-p answer 'maxima::mquote) (second answer))
          ((eq answer t) t)
          ((and (symbolp answer) (not (fboundp answer)))
           (error "the entry of ~a answers ~a by ~a, which is no function"
                  (plain-name (caar object)) (plain-name question) (plain-name answer)))
          ((symbolp answer) (maxima::mapply1 answer (cons object more) answer nil))
          (t answer))))

(maxima::defmfun maxima::$anmech_registered (table key)
  "anmech_registered('table, key): what anmech_entry has put there, the name of a function; false if nothing."
  (getf (gethash table *entries*) key))

(maxima::defmfun maxima::$anmech_answers (object question)
  "anmech_answers(object, 'question): whether its kind has an answer."
  (let ((answer (answer-of object question)))
    (and answer (not (stringp answer)))))

(defun shortened (call most)
  "CALL with dots in place of arguments of more than MOST symbols and numbers."
  (labels ((weight (form) (if (atom form) 1 (loop for part in (rest form) sum (weight part))))
           (short (form)
             (cond ((<= (weight form) most) form)
                   ((and (operator-p form 'maxima::mequal) (symbolp (second form)))
                    (list (first form) (second form) (short (third form))))
                   (t 'maxima::|$...|))))
    (cons (list (caar call)) (mapcar #'short (rest call)))))

(defun with-field-names (object)
  "OBJECT as a call that names all its arguments."
  (let ((fields (shape-fields (shape-of object))))
    (cons (first object)
          (append (loop for field in fields for value in (rest object) collect `((maxima::mequal) ,field ,value))
                  (nthcdr (length fields) (rest object))))))

(defun shown-call (object)
  "What a user may make by this call looks like it; a result tells what its parts are, and the longer ones, too."
  (if (get (caar object) 'module) (shortened object 60) (shortened (with-field-names object) 400)))

(defun display-structure (form result) (dimension-call (shown-call form) result))

(defun tex-structure (form left right)
  (maxima::tex-function (shown-call form) left right nil))

(defun wxxml-structure (form left right)
  (wxxml-call (shown-call form) left right))

;;; A structure that is shown as something else, a table for example

(maxima::defmfun maxima::$anmech_shown_as (head function)
  "anmech_shown_as('head, 'f): objects with this head are shown as the expression f(object)."
  (setf (get head 'shown-as) function
        (get head 'maxima::dimension) 'display-shown
        (get head 'maxima::tex) 'tex-shown
        (get head 'maxima::wxxml) 'wxxml-shown)
  'maxima::$done)

(defun shown-form (form)
  (maxima::mapply1 (get (caar form) 'shown-as) (list form) (caar form) nil))

(defun display-shown (form result)
  (maxima::dimension (shown-form form) result 'maxima::mparen 'maxima::mparen 0 0))

(defun tex-shown (form left right) (maxima::tex (shown-form form) left right 'maxima::mparen 'maxima::mparen))

(defun wxxml-shown (form left right)
  (funcall 'maxima::wxxml (shown-form form) left right 'maxima::mparen 'maxima::mparen))
