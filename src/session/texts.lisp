;;; anmech: what is said to the user: expressions as text, and errors that name the verb.
;;;
;;; Entry points: PLAIN-NAME, ONE-LINE, MAXIMA-TEXT, ENGLISH-LIST, *OUTER-FORM*; COMPLAIN, *VERB*, WITH-MAXIMA-ERRORS;
;;; CALL-WITH-OUTPUT-FILE; anmech_error, anmech_verb, anmech_write_text.

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

(defun english-list (names)
  (format nil "~{~a~^, ~}" (mapcar #'plain-name names)))

(defun complain (control &rest arguments)
  "Signal the error  verb: sentence."
  (maxima::merror "~A" (format nil "~@[~a: ~]~?" (and *verb* (plain-name *verb*)) control arguments)))

(maxima::defmfun maxima::$anmech_error (&rest parts)
  "anmech_error(part, ...): the error  verb: parts joined; expressions are shown on one line."
  (complain "~{~a~}" (mapcar (lambda (part) (if (stringp part) part (one-line part))) parts)))

(maxima::defmfun maxima::$anmech_verb ()
  "anmech_verb(): the verb that the user called, as a string."
  (if *verb* (plain-name *verb*) "anmech"))

(defun call-with-output-file (file writer)
  "Call WRITER with a stream to FILE, a new one; a sentence where there can be none."
  (handler-case (with-open-file (stream file :direction :output :if-exists :supersede)
                  (funcall writer stream))
    ((or file-error stream-error) () (complain "cannot write the file ~a" file))))

(maxima::defmfun maxima::$anmech_write_text (file text)
  "anmech_write_text(file, text): FILE holds TEXT."
  (call-with-output-file file (lambda (stream) (write-string text stream)))
  'maxima::$done)
