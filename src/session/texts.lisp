;;; anmech: what is said to the user: expressions as text, and errors that name the verb.
;;;
;;; Entry points: PLAIN-NAME, ONE-LINE, MAXIMA-TEXT, TYPED-NAME, ENGLISH-LIST, *OUTER-FORM*; COMPLAIN, *VERB*,
;;; WITH-MAXIMA-ERRORS; RESEMBLING-P, LIKELY-NAME; anmech_error, anmech_is_text, anmech_joined_texts, anmech_verb,
;;; anmech_resemble, anmech_name.

(in-package :anmech)

(defmacro with-maxima-errors (&body body)
  "Maxima's errors inside BODY are Lisp conditions of type maxima::maxima-$error, and print nothing."
  `(let ((maxima::*merror-signals-$error-p* t)) ,@body))

(defvar *verb* nil "The verb that the user called; nil outside of all verbs.")

(defun plain-name (symbol)
  "SYMBOL as Maxima prints it."
  (coerce (maxima::mstring symbol) 'string))

(defun one-line (expression &optional (most 200))
  "EXPRESSION in Maxima's one-line notation, cut after MOST characters."
  (let ((text (coerce (maxima::mstring expression) 'string)))
    (if (> (length text) most) (concatenate 'string (subseq text 0 most) " ...") text)))

(defvar *outer-form* #'identity "What turns the package's own form of an expression into the user's.")

(defun maxima-text (expression &optional (limit 120))
  "EXPRESSION as the user would type it, shortened to LIMIT characters."
  (let ((text (maxima::mfuncall 'maxima::$string (funcall *outer-form* expression))))
    (if (> (length text) limit) (concatenate 'string (subseq text 0 limit) "...") text)))

(defun closing-parenthesis (text start)
  "The place in TEXT of the parenthesis that closes the first one from START on; nil if there is none."
  (let ((depth 0))
    (loop for place from start below (length text)
          do (case (char text place)
               (#\( (incf depth))
               (#\) (when (zerop (decf depth)) (return place)))))))

(defun typed-text (text)
  "TEXT, as Maxima shows an expression in one line, with derivatives as a user types them: diff(x,t) for 'diff(x,t,1)."
  (let* ((start (search "'diff(" text))
         (end (and start (closing-parenthesis text start))))
    (if (null end)
        text
        (let ((single (eql (search ",1" text :start2 (- end 2) :end2 end) (- end 2))))
          (concatenate 'string (subseq text 0 start)
                       (typed-text (subseq text (1+ start) (if single (- end 2) end)))
                       (typed-text (subseq text end)))))))

(maxima::defmfun maxima::$anmech_name (form)
  "anmech_name(expr): as a user types it, a string."
  (typed-text (plain-name form)))

(defun typed-name (form)
  "FORM, which may be of the package's own, as a user types it."
  (typed-text (plain-name (funcall *outer-form* form))))

(defun english-list (names)
  (format nil "~{~a~^, ~}" (mapcar #'plain-name names)))

;;; What may have been meant

(defun edits (first second)
  "How many letters must be put in, left out, replaced or exchanged with the next one to make SECOND of FIRST."
  (let* ((columns (1+ (length second))) (before nil) (row (loop for j below columns collect j)))
    (loop for i from 1 to (length first)
          for new = (list i)
          do (loop for j from 1 below columns
                   for same = (char= (char first (1- i)) (char second (1- j)))
                   do (push (min (1+ (first new))
                                 (1+ (nth j row))
                                 (+ (nth (1- j) row) (if same 0 1))
                                 (if (and before (> j 1)
                                          (char= (char first (1- i)) (char second (- j 2)))
                                          (char= (char first (- i 2)) (char second (1- j))))
                                     (1+ (nth (- j 2) before))
                                     columns))
                            new))
             (setq before row
                   row (nreverse new)))
    (first (last row))))

(defun resembling-p (first second)
  "Whether one of two names may be a slip for the other: another case, an underscore, or, in longer ones, a letter."
  (flet ((core (name) (remove #\_ (string-downcase name))))
    (let ((first (core first)) (second (core second)))
      (or (string= first second)
          (and (> (min (length first) (length second)) 2) (<= (edits first second) 1))))))

(defun likely-name (symbol candidates)
  "The text of the one of CANDIDATES, symbols, that SYMBOL most resembles, if it may be a slip for it; or nil.  In long
names two letters may be wrong."
  (let ((text (plain-name symbol)) (likely nil) (fewest 3))
    (dolist (candidate candidates likely)
      (let* ((name (plain-name candidate))
             (distance (cond ((resembling-p text name) (min 1 (edits text name)))
                             ((and (> (min (length text) (length name)) 8) (< (abs (- (length text) (length name))) 3))
                              (edits (string-downcase text) (string-downcase name)))
                             (t fewest))))
        (when (< distance fewest) (setq likely name fewest distance))))))

(maxima::defmfun maxima::$anmech_resemble (first second)
  "anmech_resemble(string, string): whether one name may be a slip for the other."
  (resembling-p first second))

;;; Errors

(defun complain (control &rest arguments)
  "Signal the error  verb: sentence."
  (maxima::merror "~A" (format nil "~@[~a: ~]~?" (and *verb* (plain-name *verb*)) control arguments)))

(defun announces-value-p (part)
  "Whether what follows PART is what the user gave."
  (and (stringp part) (let ((place (search "found " part :from-end t))) (eql place (- (length part) 6)))))

(maxima::defmfun maxima::$anmech_error (&rest parts)
  "anmech_error(part, ...): the error  verb: parts joined.  Strings are the sentence, and expressions are shown on one
line; so is a string behind \"found \", in quotes: \"false\" is not false."
  (complain "~{~a~}" (loop for (before part) on (cons nil parts)
                           for count below (length parts)
                           collect (if (and (stringp part) (not (announces-value-p before))) part (one-line part)))))

;;; (stringp, simplode and others are in a package of Maxima's that takes SBCL more than half a second to load.)
(maxima::defmfun maxima::$anmech_is_text (object)
  "anmech_is_text(x): whether it is a string."
  (stringp object))

(maxima::defmfun maxima::$anmech_joined_texts (parts separator)
  "anmech_joined_texts([part, ...], separator): one string, parts shown on one line."
  (let ((texts (mapcar (lambda (part) (if (stringp part) part (plain-name part))) (rest parts))))
    (coerce (format nil "~a~{~a~}" (or (first texts) "") (loop for text in (rest texts) collect separator collect text))
            'simple-string)))

(maxima::defmfun maxima::$anmech_verb ()
  "anmech_verb(): the verb that the user called, as a string."
  (if *verb* (plain-name *verb*) "anmech"))
