;;;; run.lisp: runs one file of tests in a Maxima that serves nothing else.
;;;;
;;;; A file of tests, rtest_*.mac, is a sequence of pairs: an input, and the result expected of it, each ended by ;
;;;; or $.  The input is evaluated; the expected side is only parsed and simplified.  Both are compared as Maxima's own
;;;; test bench compares them (structure; floats within 8 epsilon).  In a text that is expected, a line break with an
;;;; indentation stands for a space.  A problem fails if it differs, signals an error, or asks a question, even one
;;;; that an errcatch around it hides.  A file fails too if it holds no test, stops half-way, or cannot be parsed.
;;;;
;;;; For the tests:
;;;;   error_text(expr)      the message of the error that evaluating expr signals, or false if there is none
;;;;   printed(expr)         what evaluating expr writes, as a string
;;;;   questions(expr)       the list of the questions that evaluating expr asks; they count against nothing
;;;;   scratch_file(name)    absolute name of a file in a directory of this run's own, removed afterwards
;;;;   anmech_root()         absolute name of the directory that holds share/, src/ and rtest/, with a slash at its end
;;;;   is_lisp(name)         true on the Lisp called "gcl", "sbcl" or "ecl"
;;;;   by_letters(expr)      the value of expr while no variable that a test has assigned to has a value
;;;;   if_compiled(expr)     the value of expr where the kernel is compiled; where no compiler is at hand, so that it is
;;;;                         interpreted (ECL without its headers), the problem is skipped: for those that would take
;;;;                         minutes there
;;;;   long_problem(expr)    as if_compiled, for a problem that takes seconds where the kernel is compiled, too.  With
;;;;                         the environment variable PART, 0 or 1, the files are parted between two Maximas: each
;;;;                         skips the long problems of the other's files
;;;; and what common.mac defines: texts, zero tests, numbers, chance, and the systems that many files use.
;;;; All of them are Lisp functions, so that kill(all) leaves them alone.
;;;;
;;;; For the shell (setup/run_tests.sh), a function that does not return:
;;;;   run_tests(file, report)   load the package and common.mac, run the file, write the report, leave with 0 or 1
;;;; A line of the report that starts with @ is for the shell: "@problem N LINE INPUT" before a problem is run,
;;;; "@passed", "@failed" or "@skipped WHY" after it, "@end SECONDS" when the whole file was read.  So a crash half-way
;;;; is seen, and where it was.  All other lines of the report are for the reader.
;;;;
;;;; At a prompt: load("rtest/run.lisp"), then try_tests("rtest/rtest_x.mac") prints the same report and returns.
;;;;
;;;; Maxima's run_testsuite and batch(file, 'test) do not serve: they return no verdict, and Maxima's exit status says
;;;; nothing.  The functions of Maxima used here (mread, meval*, batch-equal-check, retrieve) are the same from 5.46 to
;;;; 5.50.

(defpackage :anmech-tests (:use :common-lisp))
(in-package :anmech-tests)

(defvar *root*
  (let ((here (namestring (truename (or *load-truename* *load-pathname*)))))
    (subseq here 0 (search "rtest/run.lisp" here :from-end t)))
  "The directory above rtest/.")

(defvar *report* *standard-output* "Where the report goes.")
(defvar *questions* '() "What Maxima asked during the present problem, the last question first.")
(defvar *file* nil "The name of the file that is run, without its directory.")
(defvar *long* 3000 "The number of characters at which a text is cut in the report.")
(defvar *slow* 5 "Problems that take more seconds than this are named in the report.")

;;; Texts

(defun shortened (text &optional (longest *long*))
  (if (> (length text) longest)
      (format nil "~a ... (~d characters)" (subseq text 0 longest) (length text))
      text))

(defun trimmed (text)
  (string-trim '(#\Newline #\Space #\Tab) text))

(defun text-of (expr)
  "EXPR in one line, as a user would type it; in Lisp's notation if Maxima cannot print it."
  (handler-case (let ((maxima::$display2d nil)) (coerce (maxima::mstring expr) 'string))
    (error () (format nil "~s" expr))))

(defun report (control &rest arguments)
  (apply #'format *report* control arguments)
  (finish-output *report*))

(defun report-paragraph (label text)
  (unless (string= text "") (report "    ~10a~a~%" label (shortened text))))

;;; Questions: all that Maxima wants to know goes through its function retrieve.

(defun note-question (message flag &rest more)
  (declare (ignore flag more))
  (let ((text (trimmed (coerce (if (consp message)
                                   (apply #'maxima::$sconcat (rest message))
                                   (maxima::$sconcat message))
                               'string))))
    (push text *questions*)
    (maxima::merror "~A" (format nil "Maxima asked: ~a" text))))

;;; One problem

(defun captured (thunk)
  "The values of THUNK, a list of them, and what it wrote."
  (let* ((values '())
         (text (with-output-to-string (*standard-output*) (setq values (multiple-value-list (funcall thunk))))))
    (values values text)))

(defun caught (form)
  "The value of the Maxima expression FORM, and T; or NIL and NIL if it signals an error, whose message is printed."
  (let* ((maxima::$errormsg t)
         (answer (maxima::meval* (list '(maxima::$errcatch) form))))
    (if (maxima::$emptyp answer) (values nil nil) (values (second answer) t))))

(defun line-of (parsed)
  "The line where an expression that mread returned began, or NIL where the Lisp does not know (GCL)."
  (let ((place (second (first parsed))))
    (and (consp place) (integerp (first place)) (1+ (first place)))))

(defun unbroken-text (text)
  "TEXT with a space for every line break that an indentation follows: so a long one is written over lines."
  (let ((break (search (format nil "~% ") text)))
    (if break
        (concatenate 'string (subseq text 0 break) " "
                     (unbroken-text (string-left-trim " " (subseq text (1+ break)))))
        text)))

(defun with-unbroken-texts (form)
  (cond ((stringp form) (unbroken-text form))
        ((consp form) (cons (with-unbroken-texts (car form)) (with-unbroken-texts (cdr form))))
        (t form)))

(defun report-failure (number line input expected actual output)
  (report "  problem ~d~@[ (line ~d)~] failed~%" number line)
  (report-paragraph "input" (text-of input))
  (report-paragraph "expected" (text-of expected))
  (report-paragraph "found" actual)
  (report-paragraph "written" (trimmed output))
  (dolist (question (reverse *questions*)) (report-paragraph "question" question)))

(defun seconds-since (start)
  (/ (- (get-internal-real-time) start) (float internal-time-units-per-second 1d0)))

(defun verdict (number line input expected)
  "Runs one problem: passed, failed (and told in the report), or skipped, and why."
  (catch 'skip
    (destructuring-bind ((result fine) output)
        (multiple-value-list (captured (lambda () (caught input))))
      (setq maxima::$% result)
      (cond ((and fine (null *questions*) (maxima::batch-equal-check expected result)) "passed")
            (t (report-failure number line input expected (if fine (text-of result) "an error") output)
               "failed")))))

(defun run-problem (number line input expected)
  (let* ((*questions* '())
         (start (get-internal-real-time))
         (verdict (verdict number line input expected))
         (seconds (seconds-since start)))
    (report "@~a~%" verdict)
    (when (> seconds *slow*) (report "  problem ~d~@[ (line ~d)~] took ~,1f s~%" number line seconds))))

;;; One file

(defun next-expression (stream)
  "The next expression of STREAM as mread returns it, or NIL at the end.  A syntax error is reported and throws to
STOP."
  (let ((maxima::*mread-prompt* "") (*read-base* 10) (parsed nil) (done nil))
    (let ((output (with-output-to-string (*standard-output*)
                    (let ((*error-output* *standard-output*))      ; where 5.50 tells of syntax errors
                      (catch 'maxima::macsyma-quit
                        (setq parsed (maxima::mread stream 'eof) done t))))))
      (unless done
        (report "  ~a~%" (trimmed output))
        (throw 'stop nil))
      (if (eq parsed 'eof) nil parsed))))

(defun run-problems (stream)
  (do ((number 1 (1+ number))
       (input (next-expression stream) (next-expression stream)))
      ((null input) t)
    (report "@problem ~d ~a ~a~%" number (or (line-of input) "-") (shortened (text-of (third input)) 200))
    (let ((expected (next-expression stream)))
      (unless expected
        (report "  problem ~d is the last, and no expected result follows it: ~a~%" number (text-of (third input)))
        (throw 'stop nil))
      (run-problem number (line-of input) (third input) (with-unbroken-texts (third expected))))))

;;; Which problems are left out

(defun skip (reason)
  (throw 'skip (format nil "skipped ~a" reason)))

(defun skip-unless-compiled ()
  (unless (funcall (find-symbol "COMPILER-P" :anmech)) (skip "this kernel is interpreted")))

(defun skip-unless-mine ()
  (let ((part (parse-integer (or (maxima::maxima-getenv "PART") "") :junk-allowed t)))
    (when (and part (/= part (mod (reduce #'+ (map 'list #'char-code *file*)) 2)))
      (skip "the other compiled Maxima has them"))))

(defun must-evaluate (form what)
  (multiple-value-bind (values output) (captured (lambda () (caught form)))
    (unless (second values)
      (report "  ~a could not be loaded~%" what)
      (report-paragraph "written" (trimmed output))
      (throw 'stop nil))))

(defun call-watched (file thunk)
  "With the variable COVERAGE, a directory, what is called is noted there."
  (let ((directory (maxima::maxima-getenv "COVERAGE")))
    (when directory
      (load (concatenate 'string *root* "rtest/coverage.lisp"))
      (funcall (find-symbol "START-COVERAGE" :anmech-coverage)))
    (unwind-protect (funcall thunk)
      (when directory (funcall (find-symbol "END-COVERAGE" :anmech-coverage) directory file)))))

(defun load-package ()
  "The package, and common.mac as a module of it."
  (must-evaluate `((maxima::$load) ,(concatenate 'string *root* "share/anmech/anmech.mac")) "the package")
  (progv (list (find-symbol "*MODULE-DIRECTORY*" :anmech)) (list (concatenate 'string *root* "rtest/"))
    (must-evaluate '((maxima::$anmech_need) "common") "common.mac")))

(defun run-file (file)
  "Runs FILE; true if it was read to its end."
  (let ((asker (symbol-function 'maxima::retrieve)) (start (get-internal-real-time)) (*file* (pathname-name file)))
    (unwind-protect
         (catch 'stop
           (setf (symbol-function 'maxima::retrieve) #'note-question)
           (load-package)
           (let ((maxima::$ratprint nil))
             (call-watched file (lambda () (with-open-file (stream file) (run-problems stream)))))
           (report "@end ~,1f~%" (seconds-since start))
           t)
      (setf (symbol-function 'maxima::retrieve) asker))))

(defun leave-maxima (code)
  (finish-output)
  #+gcl (si::bye code)
  #+sbcl (sb-ext:exit :code code :abort t)
  #+ecl (ext:quit code)
  #-(or gcl sbcl ecl) (progn code (maxima::$quit)))

;;; The layer that Maxima sees

(in-package :maxima)

(defmfun $run_tests (file report)
  ;; Not with-open-file, which removes the report when Maxima's top level takes over after a crash.
  (setq anmech-tests::*report* (open report :direction :output))
  (let ((code (if (anmech-tests::run-file file) 0 1)))
    (close anmech-tests::*report*)
    (anmech-tests::leave-maxima code)))

(defmfun $try_tests (file)
  (if (anmech-tests::run-file ($file_search file)) '$done nil))

(defmspec $error_text (form)
  (let* (($errormsg nil)
         (answer (meval (list '($errcatch) (second form)))))
    (if ($emptyp answer)
        (let (($display2d nil) ($linel 10000))
          (anmech-tests::trimmed (with-output-to-string (*standard-output*) ($errormsg))))
        nil)))

(defmspec $printed (form)
  (values (with-output-to-string (*standard-output*) (meval (second form)))))

(defmspec $questions (form)
  (let ((anmech-tests::*questions* '()) ($errormsg nil))
    (meval (list '($errcatch) (second form)))
    (cons '(mlist) (reverse anmech-tests::*questions*))))

(defmspec $by_letters (form)
  (progv (remove-if (lambda (name) (find #\` (symbol-name name))) (rest $values)) '()    ; not the package's own
    (meval (second form))))

(defmspec $if_compiled (form)
  (anmech-tests::skip-unless-compiled)
  (meval (second form)))

(defmspec $long_problem (form)
  (anmech-tests::skip-unless-compiled)
  (anmech-tests::skip-unless-mine)
  (meval (second form)))

(defmfun $scratch_file (name)
  (concatenate 'string $maxima_tempdir "/" name))

(defmfun $anmech_root ()
  anmech-tests::*root*)

(defmfun $is_lisp (name)
  (string= name #+gcl "gcl" #+sbcl "sbcl" #+ecl "ecl" #-(or gcl sbcl ecl) "other"))
