;;; anmech: what helps a user at Maxima's prompt, by the names that it has there.
;;;
;;; Maxima's own  example  reads Maxima's manual only,  demo  knows no folder of ours and waits for a key even where
;;; nobody can press one,  apropos  lists every symbol there is, and a function whose name is misspelt stays what was
;;; typed, without a word.  Here each of them sees first whether it is asked about the package, and otherwise does what
;;; it always did.
;;;
;;;     example(verb)                    runs the examples of the verb's entry in the manual
;;;     demo("anmech"), demo("tour")     plays an example or a worksheet of the package, and lists the others
;;;     apropos("text")                  without the names that only the package's own files use
;;;     lagrange_sytem(L, q);            is told that lagrange_system may be meant
;;;
;;; Entry point: anmech_example_files, for tests.

(in-package :anmech)
(needs "session/examples" "session/texts" "session/verbs")

(defvar *maximas-own* '() "What Maxima does by itself: a list of (name . function).")

(defun maximas-own (name &rest arguments)
  (apply (cdr (assoc name *maximas-own*)) arguments))

(defun extend-special-form (name function)
  (unless (assoc name *maximas-own*)
    (push (cons name (get name 'maxima::mfexpr*)) *maximas-own*)
    (setf (get name 'maxima::mfexpr*) function)))

(defun extend-function (name function)
  (unless (assoc name *maximas-own*)
    (push (cons name (symbol-function name)) *maximas-own*)
    #+sbcl (sb-ext:without-package-locks (setf (symbol-function name) function))
    #-sbcl (setf (symbol-function name) function)))

;;; example

(defun verb-named (name)
  "The verb of that NAME, a string or symbol; or nil."
  (let ((text (if (stringp name) name (plain-name name))))
    (find text *verbs* :key #'plain-name :test #'string-equal)))

(defun manual-entry (name)
  "The lines of the entry NAME of the manual."
  (loop for directory being the hash-keys of cl-info::*info-tables* using (hash-value tables)
        for item = (gethash name (second tables))
        when (equal (first item) "anmech.info")
          do (return (with-input-from-string (stream (cl-info::read-info-text directory (cons name item)))
                       (loop for line = (read-line stream nil) while line collect (trimmed line))))))

(defun manual-inputs (verb)
  "The inputs of the examples in the entry of VERB, as texts."
  (let ((lines (manual-entry (plain-name verb))))
    (loop while lines
          for line = (pop lines)
          when (input-line-p line)
            collect (let ((input (list line)))
                      (loop until (or (complete-input-p input) (null lines))
                            do (setq input (append input (list (pop lines)))))
                      (input-text input)))))

(defun run-input (text)
  "Show the input TEXT, evaluate and show its value as Maxima's own example does; an error is shown, too."
  (multiple-value-bind (form silent-p) (parsed text)
    (incf maxima::$linenum)
    (let ((label (maxima::makelabel maxima::$inchar)))
      (unless maxima::$nolabels (set label form))
      (let ((maxima::$display2d nil)) (maxima::displa `((maxima::mlabel) ,label ,form)))
      (let ((answer (maxima::meval* `((maxima::$errcatch) ,form))) (output (maxima::makelabel maxima::$outchar)))
        (unless (maxima::$emptyp answer)
          (setq maxima::$% (second answer))
          (unless maxima::$nolabels (set output maxima::$%))
          (unless silent-p (maxima::displa `((maxima::mlabel) ,output ,maxima::$%))))))))

(defun show-example (form)
  (let ((verb (and (rest form) (verb-named (second form)))))
    (cond ((null (rest form))
           (append (maximas-own 'maxima::$example form)
                   (mapcar #'plain-name (remove-if-not #'manual-inputs (reverse *verbs*)))))
          ((null verb) (maximas-own 'maxima::$example form))
          (t (mapc #'run-input (manual-inputs verb))
             (setf maxima::*need-prompt* t)
             'maxima::$done))))

;;; demo

(defun example-files ()
  "The examples that lie beside the package, as pathnames."
  (let ((folder (concatenate 'string *source-directory* "../examples/")))
    (sort (append (directory (concatenate 'string folder "*.mac")) (directory (concatenate 'string folder "*.wxm")))
          #'string< :key #'pathname-name)))

(defun example-file (name)
  (let ((name (if (stringp name) name (plain-name name))))
    (find (if (string= name "anmech") "demo" name) (example-files) :key #'pathname-name :test #'string=)))

(defun somebody-answers-p ()
  "Whether there is somebody who can press a key when a demonstration pauses."
  (and (not (fboundp 'maxima::$wxstatusbar))
       #+sbcl (interactive-stream-p *standard-input*)
       #-sbcl (handler-case (eql 0 (#+gcl si:system #+ecl ext:system #-(or gcl ecl) identity "test -t 0"))
                (error () nil))))

(defun play-demo (name)
  (let ((file (and (or (stringp name) (symbolp name)) (example-file name))))
    (cond ((null file) (maximas-own 'maxima::$demo name))
          (t (let ((maxima::$file_search_maxima         ; load("anmech") in an example means this very package
                     (list* '(maxima::mlist) (concatenate 'string *module-directory* "$$$.mac")
                            (rest maxima::$file_search_maxima))))
               (maxima::mfuncall 'maxima::$batch (namestring file)
                                 (if (somebody-answers-p) 'maxima::$demo 'maxima::$batch)))
             (format t "~&More of them, played by demo(\"name\"):~%~{  ~a~%~}"
                     (wrapped-names (remove "demo" (mapcar #'pathname-name (example-files)) :test #'string=) 76))
             'maxima::$done))))

(defun wrapped-names (names width)
  "NAMES with commas, as lines of at most WIDTH characters."
  (let ((lines '()))
    (dolist (name names (reverse lines))
      (if (and lines (< (+ (length (first lines)) (length name) 2) width))
          (setf (first lines) (concatenate 'string (first lines) ", " name))
          (push name lines)))))

(maxima::defmfun maxima::$anmech_example_files ()
  "anmech_example_files(): the files that demo plays."
  (cons '(maxima::mlist maxima::simp) (mapcar #'namestring (example-files))))

;;; apropos

(defun private-name-p (name)
  "Whether NAME, a symbol, is one that only files of the package use: a helper, or a renamed local variable."
  (let ((text (plain-name name)))
    (and (not (member name *verbs*))
         (or (starts-with "anmech_" text) (find #\` text)))))

(defun apropos-without-private-names (form)
  (remove-if (lambda (name) (and (symbolp name) (private-name-p name))) (maximas-own 'maxima::$apropos form)))

;;; Misspelt verbs

(defvar *slips-told* '() "Names of which a user has been told.")

(defun known-function-p (name)
  (or (fboundp name) (get name 'maxima::mfexpr*) (maxima::mget name 'maxima::mexpr) (maxima::mget name 'maxima::mmacro)
      (get name 'maxima::operators) (get name 'maxima::dimension)))

(defun slips (form)
  "The functions called in FORM that are none, while a verb has nearly the same name: pairs of names."
  (let ((found '()))
    (labels ((walk (form)
               (when (and (consp form) (consp (car form)) (not (eq (caar form) 'maxima::mquote)))
                 (let ((name (caar form)))
                   (when (and (symbolp name) (not (member name *slips-told*)) (eql (position #\$ (symbol-name name)) 0)
                              (not (member 'maxima::array (cdar form))) (not (known-function-p name)))
                     (let ((verb (likely-name name *verbs*)))
                       (when verb (pushnew (cons name verb) found :test #'equal)))))
                 (mapc #'walk (rest form)))))
      (walk form))
    (reverse found)))

(defun evaluate-at-top (form)
  "What Maxima's prompt and batch do with an input."
  (prog1 (maximas-own 'maxima::toplevel-macsyma-eval form)
    (loop for (name . verb) in (slips form)
          do (push name *slips-told*)
             (format t "~&anmech: there is no function ~a; is ~a meant?~%" (plain-name name) verb))))

(extend-special-form 'maxima::$example 'show-example)
(extend-special-form 'maxima::$apropos 'apropos-without-private-names)
(extend-function 'maxima::$demo (lambda (name) (play-demo name)))
(extend-function 'maxima::toplevel-macsyma-eval (lambda (form) (evaluate-at-top form)))
